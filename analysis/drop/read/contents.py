"""Every drop that a file of tables holds, and what in it was not read, with the reason."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.read.blocks import blocks_of
from analysis.drop.read.readings import (
    Columns,
    Points,
    columns_of,
    counted_events,
    heights_beside,
    lone_events,
    named_times,
    paired_events,
    paths_of,
    refuse_heights,
    wide_tracks,
)
from analysis.drop.read.tables import Grid
from daq.setup.errors import InputError

Array = NDArray[np.float64]
Item = tuple[str, Array | Points]

_CLOCK_TEXT = 3  # cells like 00:00:01.5 after which a table is taken to hold clock times


@dataclass(frozen=True)
class Contents:
    """What a file holds.

    Attributes
    ----------
    found : list of (label, item)
        Drops: impact times (n,) in seconds, or `Points`.
    not_read : list of str
        Sheets, blocks and columns that were not taken for drops, each with the reason.
    """

    found: list[Item]
    not_read: list[str]


@dataclass(frozen=True)
class _Table:
    """One block and what it may be."""

    block: Grid
    columns: Columns

    @property
    def label(self) -> str:
        return self.block.name or "the table"


def read_table(grids: list[Grid], where: str) -> Array | Points:
    """The first drop of `read_tables`; raises what it raises."""
    return read_tables(grids, where).found[0][1]


def read_tables(grids: list[Grid], where: str) -> Contents:
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
    tables = [_Table(block, columns_of(block)) for grid in grids for block in blocks_of(grid)]
    strong = {k: times for k, table in enumerate(tables) if (times := _events(table)) is not None}
    if not strong:
        for table in tables:
            refuse_heights(table.columns, where)
    paths = {k: found for k, table in enumerate(tables) if k not in strong and (found := _positions(table))}
    lone = {k: lone_events(t.block.name, t.columns) for k, t in enumerate(tables) if k not in strong and k not in paths}
    if strong or (not paths and any(found for found, _ in lone.values())):
        return _times(tables, strong, paths, lone)
    if paths:
        items = [item for found in paths.values() for item in found]
        beside = [words for k in paths for words in heights_beside(tables[k].label, tables[k].columns, len(paths[k]))]
        return Contents(items, [_neither(tables[k]) for k in lone] + beside)
    raise InputError(
        f"{where}: neither impact times (event times with intervals, s) nor tracked positions (time or frame, height) "
        f"found in {len(grids)} sheet(s); first heading: {', '.join(tables[0].columns.names[:6]) or 'none'}"
        + _clocks_in_words(grids)
        + "".join(f"; {words}" for _, not_taken in lone.values() for words in not_taken[:3])
    )


def _times(
    tables: list[_Table],
    strong: dict[int, Array],
    paths: dict[int, list[Item]],
    lone: dict[int, tuple[list[tuple[str, Array]], list[str]]],
) -> Contents:
    """Tables of times; beside times with their intervals or numbers, bare columns count only by their heading."""
    events: list[tuple[str, Array]] = []
    not_read: list[str] = []
    for k, table in enumerate(tables):
        if k in strong:
            events.append((table.block.name, strong[k]))
        elif k in paths:
            not_read.append(f"{table.label}: positions, beside impact times; give them in a file of their own")
        else:
            found, words = lone[k]
            taken = [item for item in found if not strong or named_times(item[0])]
            events += taken
            not_read += words
            if not taken and not words:
                not_read.append(_neither(table))
    kept, copies = _unlike(events)
    return Contents([(name, times) for name, times in kept], not_read + copies)


def _events(table: _Table) -> Array | None:
    times = paired_events(table.columns)
    return times if times is not None else counted_events(table.columns)


def _positions(table: _Table) -> list[Item]:
    points = wide_tracks(table.block)
    return [(table.block.name, points)] if points is not None else paths_of(table.block.name, table.columns)


def _neither(table: _Table) -> str:
    heading = ", ".join(name for name in table.columns.names[:6] if name) or "no heading"
    return f"{table.label} ({heading}): neither impact times nor positions with their times"


def _unlike(events: list[tuple[str, Array]]) -> tuple[list[tuple[str, Array]], list[str]]:
    """Lists of events without copies or parts of another, as a workbook's summaries are; and those, in words."""
    kept: list[tuple[str, Array]] = []
    copies: list[str] = []
    for name, times in sorted(events, key=lambda item: -len(item[1])):
        same = next((label for label, other in kept if _part_of(times, other)), None)
        if same is None:
            kept.append((name, times))
        else:
            copies.append(f"{name or 'a table'}: the same times as {same or 'another table'}, which would count twice")
    order = {id(times): k for k, (_, times) in enumerate(events)}
    return sorted(kept, key=lambda item: order[id(item[1])]), copies


def _part_of(times: Array, other: Array) -> bool:
    slack = 1e-6 + 1e-6 * float(np.abs(other).max(initial=0.0))
    return bool(np.all(np.abs(times[:, None] - other[None]).min(axis=1) <= slack))


def _clocks_in_words(grids: list[Grid]) -> str:
    """A hint where cells hold the time of day."""
    cells = [str(cell) for grid in grids for row in grid.rows for cell in row if isinstance(cell, str)]
    clocks = [cell for cell in cells if cell.count(":") == 2 and cell.replace(":", "")[-1:].isdigit()]
    if len(clocks) < _CLOCK_TEXT:
        return ""
    return f"; cells such as {clocks[0]!r} are times of day or dates: give seconds, as plain numbers"
