"""Every drop of a file of tables, by its content: impact times or tracked positions; and what was not read, and why.

Two columns of which one is the differences of the other are event times with their intervals, in whatever language; a
column that advances evenly and has others with it is a clock of positions. Headings only break ties, and give units.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from analysis.drop.read.blocks import blocks_of
from daq.importers.tables import Sheet, Table, split_unit, table_of
from daq.setup.errors import InputError
from kernels.arrays import Floats

# Words of headings, in the languages that programs and people write.
_TIME = {
    "t", "time", "times", "zeit", "tempo", "temps", "tijd", "tiempo", "czas", "seconds", "sekunden", "secondi",
    "clock",
}  # fmt: skip
_FRAME = {"frame", "frames", "bild", "bildnummer", "fotogramma", "image", "slice", "beeld", "step", "pas"}
_HEIGHT = {
    "y", "h", "height", "höhe", "hoehe", "altezza", "hoogte", "hauteur", "altura", "z", "s", "position", "posizione",
    "positie", "quota", "y1", "distance", "distanza", "altitude", "depth", "weg",
}  # fmt: skip
_ACROSS = {"x", "x1"}
_RUN = {"drop", "run", "trial", "lancio", "versuch", "ball", "kugel"}
_INTERVAL = {
    "interval", "intervals", "intervall", "intervalle", "intervallo", "intervalli", "difference", "differenz",
    "differenza", "verschil", "durata", "dauer", "duur", "dt", "flight",
}  # fmt: skip
_SUMMARY = {
    "mean", "average", "avg", "median", "std", "sd", "stdev", "sigma", "error", "err", "uncertainty", "mittelwert",
    "mittel", "media", "moyenne", "gemiddelde", "promedio", "fehler", "errore", "residual", "fit", "model",
}  # fmt: skip
_METRES = {
    "m": 1.0, "cm": 1e-2, "mm": 1e-3, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "metri": 1.0,
    "ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
}  # fmt: skip
_SECONDS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "milliseconds": 1e-3, "min": 60.0}
_ANGLES = {"deg", "degree", "degrees", "°", "grad", "rad"}
_LEAST_POSITIONS = 6


@dataclass(frozen=True)
class Points:
    """Tracked positions, one or more at each instant."""

    clock: Floats  # (n,) frame number, or seconds
    x: Floats  # pixels, or metres where ``metres`` is set, (n,)
    y: Floats  # the same, (n,)
    in_seconds: bool  # whether ``clock`` is in seconds
    metres: bool  # whether positions are metres


@dataclass(frozen=True)
class Columns(Table):
    """A table's columns, by the words of their headings."""

    @property
    def words(self) -> list[set[str]]:
        """Words of each heading, its unit left out."""
        return [_words(split_unit(heading, _METRES | _SECONDS)[0]) for heading in self.headings]

    def second_s(self, j: int) -> float:
        """A column's unit of time, s."""
        return _SECONDS.get(split_unit(self.headings[j], _SECONDS)[1], 1.0)

    def is_angle(self, j: int) -> bool:
        """Whether a column is headed with a unit of angles, which are no heights."""
        return split_unit(self.headings[j], _ANGLES)[1] in _ANGLES


def _words(heading: str) -> set[str]:
    return set(re.split(r"[^\w]+|_", re.sub(r"[(\[].*?[)\]]", " ", heading))) - {""}


def refuse_heights(columns: Columns, where: str) -> None:
    """Refuse rebound heights by number: they are no times and no positions."""
    v, words = columns.values, columns.words
    for a, b in _pairs(columns):
        if not words[b] & _HEIGHT or words[a] & (_TIME | _FRAME) or not 3 <= len(v) <= 40:
            continue
        ratio = v[1:, b] / np.where(v[:-1, b] == 0.0, np.nan, v[:-1, b])
        counted = np.all(np.isfinite(v[:, [a, b]])) and np.all(np.diff(v[:, a]) == 1.0)
        if counted and np.all((ratio > 0.0) & (ratio < 1.0)):
            raise InputError(
                f"{where}: columns {columns.headings[a]!r} and {columns.headings[b]!r} look like rebound heights by "
                "number; heights read off are not judged here: give impact times, or positions with their times"
            )


def _pairs(columns: Columns) -> list[tuple[int, int]]:
    width = columns.values.shape[1]
    return [(a, b) for a in range(width) for b in range(width) if a != b]


def event_times(columns: Columns) -> Floats | None:
    """Event times with their own differences, whichever comes first; or with nothing but their numbers."""
    v = columns.values
    for a, b in _pairs(columns):
        good = np.isfinite(v[:, a])
        times, intervals = v[good, a], v[good, b]
        steps = np.diff(times)
        if len(times) < 3 or np.any(steps <= 0):
            continue
        slack = 2e-3 * float(steps.max()) + 1e-6
        if np.ptp(steps) <= slack:
            continue  # a clock
        for shifted in (intervals[:-1], intervals[1:]):
            if np.isfinite(shifted).sum() >= 2 and np.nanmax(np.abs(shifted - steps)) <= slack:
                return np.asarray(times * columns.second_s(a), dtype=np.float64)
    if v.shape[1] != 2 or not np.all(np.isfinite(v)):
        return None
    for number, time in ((0, 1), (1, 0)):
        counted = np.all(np.diff(v[:, number]) == 1.0) and _is_rising(v[:, time]) and not _is_even(v[:, time])
        if counted and columns.words[time] & _TIME:
            return np.asarray(v[:, time] * columns.second_s(time), dtype=np.float64)
    return None


def lone_events(label: str, columns: Columns) -> tuple[list[tuple[str, Floats]], list[str]]:
    """Columns of times or intervals, each a drop, or rows of times; and what was not taken for one, with the reason."""
    v = columns.values
    if v.shape[1] >= 3 and v.shape[1] > v.shape[0] and not any(columns.headings):
        rows = [(k, row[np.isfinite(row)]) for k, row in enumerate(v)]
        times = [(k, row) for k, row in rows if len(row) >= 3 and _is_rising(row) and not _is_even(row)]
        return [(f"{label} row {k + 1}".strip(), row) for k, row in times], []
    found: list[tuple[str, Floats]] = []
    not_taken: list[str] = []
    for j, heading in enumerate(columns.headings):
        column, words = columns.numbers(j), columns.words[j]
        name = f"{label} {heading}".strip() or f"column {j + 1}"
        rising, counting = _is_rising(column), len(column) > 1 and np.ptp(np.diff(column)) < 1e-9
        unnamed = not rising and not named_times(heading)
        why = ""
        if words & _SUMMARY:
            why = "a mean, an error or a fit by its heading, no drop"
        elif len(column) < 2 or np.any(column < 0):
            why = "fewer than two numbers, or negative ones, are no impact times"
        elif rising and len(column) == 2:
            why = "two impacts; a drop test needs three that follow each other"
        elif unnamed and words & _HEIGHT:
            why = "rebound heights without times; heights read off are not judged here: give impact times"
        elif unnamed and not heading:
            why = "bare numbers may be intervals or rebound heights: write a heading over them, as interval (s)"
        elif words & _INTERVAL or (not rising and np.all(column > 0)):
            steps = column[:-1] if column[-1] == 0.0 else column
            found.append((name, np.concatenate(([0.0], np.cumsum(steps))) * columns.second_s(j)))
        elif rising and not counting:
            found.append((name, column * columns.second_s(j)))
        elif not counting:
            why = "no times that grow, no intervals above zero"
        not_taken += [f"{name}: {why}"] if why else []
    return found, not_taken


def named_times(label: str) -> bool:
    """Whether a heading says times or intervals."""
    return bool(_words(label) & (_TIME | _INTERVAL))


def further_heights(label: str, columns: Columns, n_read: int) -> list[str]:
    """Columns of heights of a table of positions beyond the ``n_read`` that are read, in words."""
    words = columns.words
    if any(own & _ACROSS for own in words):
        return []
    heights = [j for j, own in enumerate(words) if own & _HEIGHT]
    varied = [j for j in heights if len(v := columns.numbers(j)) >= _LEAST_POSITIONS and np.std(v) > 0.0]
    said = "more heights; another ball, or the same once more: give each a file of its own"
    return [f"{label}, {columns.headings[j]}: {said}" for j in varied[n_read:]]


def wide_tracks(grid: Sheet) -> Points | None:
    """ImageJ's table: frame, then x, y (and a flag) for each track; blanks may have been lost on the way."""
    head = next((row for row in grid.rows[:8] if len(row) >= 3 and _words(str(row[0]).lower()) & _FRAME), None)
    if head is None or not re.fullmatch(r"x\s*_?1", str(head[1]).strip().lower()):
        return None
    found: list[tuple[float, float, float]] = []
    for row in grid.rows:
        numbers = [cell for cell in row if isinstance(cell, float)]
        is_framed = bool(numbers) and isinstance(row[0], float) and numbers[0] == round(numbers[0])
        if is_framed and len(numbers) >= 3 and len(numbers) % 2 == 1:
            found += [(numbers[0], numbers[i], numbers[i + 1]) for i in range(1, len(numbers), 2)]
    if len(found) < _LEAST_POSITIONS:
        return None
    clock, x, y = np.array(sorted(found, key=lambda point: point[0])).T
    return Points(clock, x, y, in_seconds=False, metres=False)


def paths_of(label: str, columns: Columns) -> list[tuple[str, Floats | Points]]:
    """Paths of a table: one, or one for each of several heights that are numbered alike."""
    names = columns.headings
    stems = [re.sub(r"[\W_]*\d+$", "", re.sub(r"[(\[].*?[)\]]", "", name).strip()) for name in names]
    numbered = [j for j, name in enumerate(names) if re.search(r"\d\s*$", re.sub(r"[(\[].*", "", name))]
    across = any(_words(stem) & _ACROSS for stem in stems)
    for stem in dict.fromkeys(stems[j] for j in numbered):
        alike = [j for j in numbered if stems[j] == stem]
        if len(alike) >= 2 and _words(stem) & (_HEIGHT | _RUN) and not across:
            others = [j for j in range(len(stems)) if j not in alike]
            parts = [Columns([names[k] for k in [*others, j]], columns.values[:, [*others, j]]) for j in alike]
            bare = [f"{label} {split_unit(names[j], _METRES)[0]}".strip() for j in alike]
            found = [(name, _positions(part)) for name, part in zip(bare, parts, strict=True)]
            return [(name, points) for name, points in found if points is not None]
    points = _positions(columns)
    return [] if points is None else [(label, points)]


def _positions(columns: Columns) -> Points | None:
    """A clock column and a height column; further columns may be the position across, speeds, anything."""
    v, words = columns.values, columns.words
    every = range(v.shape[1])
    long = [j for j in every if len(columns.numbers(j)) >= _LEAST_POSITIONS]
    advancing = [j for j in long if columns.numbers(j)[-1] > columns.numbers(j)[0]]
    clock = next((j for j in advancing if words[j] & _TIME), None)
    frames = next((j for j in advancing if words[j] & _FRAME), None)
    chosen = clock if clock is not None else frames
    if chosen is None:
        chosen = next((j for j in every if _is_even(columns.numbers(j))), None)
    others = [j for j in long if j not in (clock, frames, chosen) and not columns.is_angle(j)]
    if chosen is None or not others:
        return None
    named = [j for j in others if words[j] & _HEIGHT]
    if not named:  # the one that moves most
        ranges = np.nanmax(v, axis=0, initial=-np.inf) - np.nanmin(v, axis=0, initial=np.inf)
        named = sorted((j for j in others if not words[j] & _ACROSS), key=lambda j: -float(ranges[j]))
    height = (named or others)[0]
    across = next((j for j in others if words[j] & _ACROSS), None)
    used = [chosen, height] if across is None else [chosen, height, across]
    rows = v[np.isfinite(v[:, used]).all(axis=1)]
    rows = rows[np.argsort(rows[:, chosen], kind="stable")]
    unit = _METRES.get(split_unit(columns.headings[height], _METRES)[1])
    if unit is None and _is_rising(rows[:, height]):
        return None  # what only grows with its row is a list of times
    y = rows[:, height] * (unit or 1.0)
    x = rows[:, across] * (unit or 1.0) if across is not None else np.zeros_like(y)
    time = rows[:, chosen]
    in_seconds = clock is not None or (frames is None and not np.all(time == np.round(time)))
    return Points(time * (columns.second_s(chosen) if in_seconds else 1.0), x, y, in_seconds, unit is not None)


def _is_rising(column: Floats) -> bool:
    return bool(np.all(np.diff(column) > 0.0))


def _is_even(column: Floats) -> bool:
    """Whether a column advances by even steps, as a clock does."""
    steps = np.diff(column[np.isfinite(column)])
    if len(steps) < _LEAST_POSITIONS - 1 or not np.all(steps > 0):
        return False
    return float(np.median(np.abs(steps - np.median(steps)))) < 0.05 * float(np.median(steps))


Item = tuple[str, Floats | Points]


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
        self.times = event_times(self.columns)
        self.paths: list[Item] = []
        if self.times is None:
            wide = wide_tracks(block)
            self.paths = [(block.name, wide)] if wide is not None else paths_of(block.name, self.columns)
        is_bare = self.times is None and not self.paths
        self.bare, self.words = lone_events(block.name, self.columns) if is_bare else ([], [])

    @property
    def label(self) -> str:
        return self.name or "the table"

    @property
    def neither(self) -> str:
        heading = ", ".join(name for name in self.columns.headings[:6] if name) or "no heading"
        return f"{self.label} ({heading}): neither impact times nor positions with their times"


def read_tables(grids: list[Sheet], where: str) -> Contents:
    """Every drop of a file, and what was not read.

    Raises `InputError` where no drop can be found, and for a table of rebound heights.
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
            refuse_heights(table.columns, where)
    items = [item for table in tables for item in table.paths]
    if not items and not strong and any(t.columns.is_angle(j) for t in tables for j in range(len(t.columns.headings))):
        raise InputError(f"{where}: angles are no heights: give the ball's, as height (m), or its place in pixels")
    if strong or (not items and any(table.bare for table in tables)):
        return _of_times(tables, strong)
    if items:
        further = [w for t in tables if t.paths for w in further_heights(t.label, t.columns, len(t.paths))]
        return Contents(items, [table.neither for table in tables if not table.paths] + further)
    cells = [str(cell) for grid in grids for row in grid.rows for cell in row if isinstance(cell, str)]
    clocks = [cell for cell in cells if cell.count(":") == 2 and cell.replace(":", "")[-1:].isdigit()]
    hint = ""
    if len(clocks) >= 3:  # from three cells like 00:00:01.5 on a table is taken to hold clock times
        hint = f"; cells such as {clocks[0]!r} are times of day or dates: give seconds, as plain numbers"
    raise InputError(
        f"{where}: neither impact times (event times with intervals, s) nor tracked positions (time or frame, height) "
        f"found in {len(grids)} sheet(s); first heading: {', '.join(tables[0].columns.headings[:6]) or 'none'}"
        + hint
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
            taken = [item for item in table.bare if not strong or named_times(item[0])]
            events += taken
            not_read += table.words or ([] if taken else [table.neither])

    # A workbook's summaries repeat other lists, or parts of them; the longest list is the one.
    def is_part_of(times: Floats, other: Floats) -> bool:
        slack = 1e-6 + 1e-6 * float(np.abs(other).max(initial=0.0))
        return bool(np.all(np.abs(times[:, None] - other[None]).min(axis=1) <= slack))

    first_of: dict[int, str] = {}
    for k in sorted(range(len(events)), key=lambda k: -len(events[k][1])):
        name, times = events[k]
        same = next((label for other, label in first_of.items() if is_part_of(times, events[other][1])), None)
        if same is None:
            first_of[k] = name
        else:
            not_read.append(
                f"{name or 'a table'}: the same times as {same or 'another table'}, which would count twice"
            )
    return Contents([events[k] for k in sorted(first_of)], not_read)
