"""Every drop that a file of tables holds, and what in it was not read, with the reason."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.read import readings
from analysis.drop.read.blocks import blocks_of
from analysis.drop.read.readings import Columns, Points
from daq.importers.tables import Sheet, table_of
from daq.setup.errors import InputError
from kernels.arrays import Floats

Item = tuple[str, Floats | Points]

_CLOCK_TEXT = 3  # cells like 00:00:01.5 after which a table is taken to hold clock times


@dataclass(frozen=True)
class Contents:
    """Drops of a file, and the rest of it."""

    found: list[Item]  # (label, drop): impact times (n,) in seconds, or `Points`
    not_read: list[str]  # sheets, blocks and columns that were not taken for drops, each with the reason


class _Table:
    """One block and what it may be: times with their intervals, positions, or else columns of bare times."""

    def __init__(self, block: Sheet) -> None:
        self.name = block.name
        self.columns: Columns = Columns(**vars(table_of(block.rows)))
        self.times = readings.event_times(self.columns)
        self.paths: list[Item] = []
        if self.times is None:
            wide = readings.wide_tracks(block)
            self.paths = [(block.name, wide)] if wide is not None else readings.paths_of(block.name, self.columns)
        is_bare = self.times is None and not self.paths
        self.bare, self.words = readings.lone_events(block.name, self.columns) if is_bare else ([], [])

    @property
    def label(self) -> str:
        return self.name or "the table"

    @property
    def neither(self) -> str:
        heading = ", ".join(name for name in self.columns.headings[:6] if name) or "no heading"
        return f"{self.label} ({heading}): neither impact times nor positions with their times"


def read_tables(grids: list[Sheet], where: str) -> Contents:
    """Every drop of a file, and what was not read.

    Raises
    ------
    InputError
        No drop can be found; or a table of rebound heights.
    """
    hidden = [grid.name for grid in grids if grid.hidden] if not all(grid.hidden for grid in grids) else []
    if hidden:
        contents = read_tables([grid for grid in grids if not grid.hidden], where)
        words = [f"{name}: hidden in the workbook; unhide the sheet to have it read" for name in hidden]
        return Contents(contents.found, contents.not_read + words)
    tables = [_Table(block) for grid in grids for block in blocks_of(grid)]
    strong = any(table.times is not None for table in tables)
    if not strong:
        for table in tables:
            readings.refuse_heights(table.columns, where)
    items = [item for table in tables for item in table.paths]
    if strong or (not items and any(table.bare for table in tables)):
        return _of_times(tables, strong)
    if items:
        further = [w for t in tables if t.paths for w in readings.further_heights(t.label, t.columns, len(t.paths))]
        return Contents(items, [table.neither for table in tables if not table.paths] + further)
    cells = [str(cell) for grid in grids for row in grid.rows for cell in row if isinstance(cell, str)]
    clocks = [cell for cell in cells if cell.count(":") == 2 and cell.replace(":", "")[-1:].isdigit()]
    hint = f"; cells such as {clocks[0]!r} are times of day or dates: give seconds, as plain numbers" if clocks else ""
    raise InputError(
        f"{where}: neither impact times (event times with intervals, s) nor tracked positions (time or frame, height) "
        f"found in {len(grids)} sheet(s); first heading: {', '.join(tables[0].columns.headings[:6]) or 'none'}"
        + (hint if len(clocks) >= _CLOCK_TEXT else "")
        + "".join(f"; {words}" for table in tables for words in table.words[:3])
    )


def _of_times(tables: list[_Table], strong: bool) -> Contents:
    """Tables of times; where some have their intervals or numbers, bare columns count only by their heading."""
    events: list[tuple[str, Floats]] = []
    not_read: list[str] = []
    for table in tables:
        if table.times is not None:
            events.append((table.name, table.times))
        elif table.paths:
            not_read.append(f"{table.label}: positions, with impact times; give them in a file of their own")
        else:
            taken = [item for item in table.bare if not strong or readings.named_times(item[0])]
            events += taken
            not_read += table.words or ([] if taken else [table.neither])
    # A workbook's summaries repeat other lists, or parts of them; the longest list is the one.
    first_of: dict[int, str] = {}
    for k in sorted(range(len(events)), key=lambda k: -len(events[k][1])):
        name, times = events[k]
        same = next((label for other, label in first_of.items() if _is_part_of(times, events[other][1])), None)
        if same is None:
            first_of[k] = name
        else:
            not_read.append(
                f"{name or 'a table'}: the same times as {same or 'another table'}, which would count twice"
            )
    return Contents([events[k] for k in sorted(first_of)], not_read)


def _is_part_of(times: Floats, other: Floats) -> bool:
    slack = 1e-6 + 1e-6 * float(np.abs(other).max(initial=0.0))
    return bool(np.all(np.abs(times[:, None] - other[None]).min(axis=1) <= slack))
