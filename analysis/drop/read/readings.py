"""Impact times or tracked positions from one table, by its content.

Two columns of which one is the differences of the other are event times with their intervals, in whatever language; a
column that advances evenly beside others is a clock beside positions. Headings only break ties, and give units.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.read.tables import Cell, Grid
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_TIME = {
    "t",
    "time",
    "times",
    "zeit",
    "tempo",
    "temps",
    "tijd",
    "tiempo",
    "czas",
    "seconds",
    "sekunden",
    "secondi",
    "clock",
}
_FRAME = {"frame", "frames", "bild", "bildnummer", "fotogramma", "image", "slice", "beeld", "step", "pas"}
_HEIGHT = {
    "y",
    "h",
    "height",
    "höhe",
    "hoehe",
    "altezza",
    "hoogte",
    "hauteur",
    "altura",
    "z",
    "s",
    "position",
    "posizione",
    "positie",
    "quota",
    "y1",
}
_ACROSS = {"x", "x1"}
_RUN = {"drop", "run", "trial", "lancio", "versuch", "ball", "kugel"}
_MOST_REBOUNDS = 40
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_SECONDS = {"s": 1.0, "sec": 1.0, "ms": 1e-3}
_UNITS = {*_METRES, *_SECONDS, "px", "pixel", "pixels", "frame", "frames", "deg", "rad", "1", ""}
_INTERVAL = {
    "interval",
    "intervals",
    "intervall",
    "intervalle",
    "intervallo",
    "intervalli",
    "difference",
    "differenz",
    "differenza",
    "verschil",
    "durata",
    "dauer",
    "duur",
    "dt",
    "flight",
}
_SUMMARY = {
    "mean", "average", "avg", "median", "std", "sd", "stdev", "sigma", "error", "err", "uncertainty", "mittelwert",
    "mittel", "media", "moyenne", "gemiddelde", "promedio", "fehler", "errore", "residual", "fit", "model",
}  # fmt: skip


@dataclass(frozen=True)
class Points:
    """Tracked positions, one or more at each instant.

    Attributes
    ----------
    clock : (n,) float64
        Frame number, or seconds.
    x, y : (n,) float64
        Positions in pixels, or in metres where ``metres`` is set.
    in_seconds : bool
        Whether ``clock`` is in seconds.
    metres : bool
        Whether positions are metres.
    """

    clock: Array
    x: Array
    y: Array
    in_seconds: bool
    metres: bool


@dataclass(frozen=True)
class Columns:
    """A table split into headings and numbers.

    Attributes
    ----------
    names : list of str
    values : (rows, columns) float64
        NaN where there is no number.
    """

    names: list[str]
    values: Array


def refuse_heights(columns: Columns, where: str) -> None:
    """Rebound heights by number: no times, no positions."""
    v, words = columns.values, [_words(name) for name in columns.names]
    for a in range(v.shape[1]):
        for b in range(v.shape[1]):
            if a == b or len(v) < 3 or not np.all(np.isfinite(v[:, [a, b]])):
                continue
            counted = np.all(np.diff(v[:, a]) == 1.0) and not words[a] & (_TIME | _FRAME)
            ratio = v[1:, b] / np.where(v[:-1, b] == 0.0, np.nan, v[:-1, b])
            if counted and words[b] & _HEIGHT and len(v) <= _MOST_REBOUNDS and np.all((ratio > 0.0) & (ratio < 1.0)):
                raise InputError(
                    f"{where}: columns {columns.names[a]!r} and {columns.names[b]!r} look like rebound heights by "
                    "number; heights read off are not judged here: give impact times, or positions with their times"
                )


def columns_of(grid: Grid) -> Columns:
    """Split a grid into headings and numbers: data are the rows with as many numbers as most have."""
    counts = np.array([sum(isinstance(cell, float) for cell in row) for row in grid.rows])
    wanted = int(np.median(counts[counts > 0]))
    data = [i for i in range(len(grid.rows)) if counts[i] >= max(1, 0.5 * wanted)]
    width = max(len(grid.rows[i]) for i in data)
    values = np.full((len(data), width), np.nan)
    for k, i in enumerate(data):
        for j, cell in enumerate(grid.rows[i]):
            if isinstance(cell, float):
                values[k, j] = cell
    heads = [row for row in grid.rows[: data[0]] if row]
    return Columns(_names(heads, width), values)


def _names(heads: list[list[Cell]], width: int) -> list[str]:
    """Headings of the fullest row above the data, with a row of units right below it joined on."""
    if not heads:
        return [""] * width
    full = max(range(len(heads)), key=lambda i: (sum(bool(str(c)) for c in heads[i]), i))
    rows = [heads[full]]
    below = heads[full + 1 :]
    if full > 0 and all(_unit(str(c)) for c in heads[full] if str(c)):
        rows = [heads[full - 1], heads[full]]
    elif below and all(_unit(str(c)) for c in below[0] if str(c)):
        rows.append(below[0])
    return [" ".join(str(row[j]) for row in rows if j < len(row)).strip().lower() for j in range(width)]


def _unit(text: str) -> bool:
    bare = re.sub(r"[\^*²]\d*$", "", text.strip("()[] ").lower())  # m/s^2 is a unit, too
    return all(part.strip("^2²") in _UNITS for part in re.split(r"[/·* ]", bare))


def _words(name: str) -> set[str]:
    """Words of a heading, its unit in brackets left out."""
    bare = re.sub(r"[(\[].*?[)\]]", " ", name)
    return set(re.split(r"[^\w]+|_", bare)) - {""}


def _unit_factor(name: str, table: dict[str, float]) -> float | None:
    """Factor to the SI unit named in a heading as ``y (cm)``, ``y [cm]``, ``y / cm`` or ``y_cm``."""
    for token in re.findall(r"[(\[]\s*([a-z]+)\s*[)\]]|/\s*([a-z]+)$|[_ ]([a-z]+)$", name):
        unit = next(part for part in token if part)
        if unit in table:
            return table[unit]
    return None


def paired_events(columns: Columns) -> Array | None:
    """Event times beside their own differences, whichever comes first."""
    v = columns.values
    for a in range(v.shape[1]):
        for b in range(v.shape[1]):
            times, intervals = v[:, a], v[:, b]
            good = np.isfinite(times)
            times, intervals = times[good], intervals[good]
            if a == b or len(times) < 3 or np.any(np.diff(times) <= 0):
                continue
            steps = np.diff(times)
            slack = 2e-3 * float(steps.max()) + 1e-6
            if np.ptp(steps) <= slack:
                continue  # a clock
            for shifted in (intervals[:-1], intervals[1:]):
                if np.isfinite(shifted).sum() >= 2 and np.nanmax(np.abs(shifted - steps)) <= slack:
                    return times * (_unit_factor(columns.names[a], _SECONDS) or 1.0)
    return None


def counted_events(columns: Columns) -> Array | None:
    """Event times beside nothing but their numbers: a counter, and a column of times that is no clock."""
    v = columns.values
    if v.shape[1] != 2:
        return None
    for counter, times in ((0, 1), (1, 0)):
        numbered = np.all(np.isfinite(v)) and np.all(np.diff(v[:, counter]) == 1.0)
        rising = np.all(np.diff(v[:, times]) > 0.0) and not _even(v[:, times])
        if numbered and rising and _words(columns.names[times]) & _TIME:
            return np.asarray(v[:, times] * (_unit_factor(columns.names[times], _SECONDS) or 1.0))
    return None


def lone_events(label: str, columns: Columns) -> tuple[list[tuple[str, Array]], list[str]]:
    """Columns of times or intervals, each a drop, or rows of times; and what was not taken for one, with the reason."""
    v = columns.values
    if v.shape[1] >= 3 and v.shape[1] > v.shape[0] and not any(columns.names):
        rows = [row[np.isfinite(row)] for row in v]
        times = [(k, row) for k, row in enumerate(rows) if len(row) >= 3 and _rising(row) and not _even(row)]
        return [(f"{label} row {k + 1}".strip(), row) for k, row in times], []
    found: list[tuple[str, Array]] = []
    not_taken: list[str] = []
    for j, heading in enumerate(columns.names):
        column = v[np.isfinite(v[:, j]), j]
        name = f"{label} {heading}".strip() or f"column {j + 1}"
        factor = _unit_factor(heading, _SECONDS) or 1.0
        rising, counting = bool(np.all(np.diff(column) > 0)), len(column) > 1 and np.ptp(np.diff(column)) < 1e-9
        if _words(heading) & _SUMMARY:
            not_taken.append(f"{name}: a mean, an error or a fit by its heading, no drop")
        elif len(column) < 2 or np.any(column < 0):
            not_taken.append(f"{name}: fewer than two numbers, or negative ones, are no impact times")
        elif rising and len(column) == 2:
            not_taken.append(f"{name}: two impacts; a drop test needs three that follow each other")
        elif not rising and not named_times(heading) and (why := _no_intervals(heading, column)):
            not_taken.append(f"{name}: {why}")
        elif _words(heading) & _INTERVAL or (not rising and np.all(column > 0)):
            trailing = column[:-1] if column[-1] == 0.0 else column
            found.append((name, np.concatenate(([0.0], np.cumsum(trailing))) * factor))
        elif rising and not counting and len(column) >= 3:
            found.append((name, column * factor))
        elif not counting:
            not_taken.append(f"{name}: no times that grow, no intervals above zero")
    return found, not_taken


def _no_intervals(heading: str, column: Array) -> str | None:
    """Why a column that no heading calls times or intervals may be none; None where it may pass for intervals."""
    if _words(heading) & _HEIGHT:
        return "rebound heights without times; heights read off are not judged here: give impact times"
    if not heading and bool(np.all(np.diff(column) < 0.0)):
        return "numbers that shrink may be intervals or rebound heights: write a heading over them, as interval (s)"
    return None


def heights_beside(label: str, columns: Columns, n_read: int) -> list[str]:
    """Columns of heights of a table of positions beyond the ``n_read`` that are read, in words."""
    if any(_words(name) & _ACROSS for name in columns.names):
        return []
    heights = [j for j, name in enumerate(columns.names) if _words(name) & _HEIGHT]
    varied = [j for j in heights if np.isfinite(v := columns.values[:, j]).sum() >= 6 and np.nanstd(v) > 0.0]
    words = "heights beside others; another ball, or the same once more: give each a file of its own"
    return [f"{label}, {columns.names[j]}: {words}" for j in varied[n_read:]]


def _rising(column: Array) -> bool:
    return bool(np.all(np.diff(column) > 0.0))


def named_times(label: str) -> bool:
    """Whether a heading says times or intervals."""
    return bool(_words(label) & (_TIME | _INTERVAL))


def wide_tracks(grid: Grid) -> Points | None:
    """ImageJ's table: frame, then x, y (and a flag) for each track; blanks may have been lost on the way."""
    head = next((row for row in grid.rows[:8] if len(row) >= 3 and _words(str(row[0]).lower()) & _FRAME), None)
    if head is None or not re.fullmatch(r"x\s*_?1", str(head[1]).strip().lower()):
        return None
    found: list[tuple[float, float, float]] = []
    for row in grid.rows:
        numbers = [cell for cell in row if isinstance(cell, float)]
        framed = bool(numbers) and isinstance(row[0], float) and numbers[0] == round(numbers[0])
        if framed and len(numbers) >= 3 and len(numbers) % 2 == 1:
            found += [(numbers[0], numbers[i], numbers[i + 1]) for i in range(1, len(numbers), 2)]
    if len(found) < 6:
        return None
    table = np.array(sorted(found, key=lambda point: point[0]))
    return Points(table[:, 0], table[:, 1], table[:, 2], in_seconds=False, metres=False)


def paths_of(label: str, columns: Columns) -> list[tuple[str, Array | Points]]:
    """Paths of a table: one, or one for each of several heights that are numbered alike."""
    stems = [re.sub(r"[\W_]*\d+$", "", re.sub(r"[(\[].*?[)\]]", "", name).strip()) for name in columns.names]
    numbered = [j for j, name in enumerate(columns.names) if re.search(r"\d\s*$", re.sub(r"[(\[].*", "", name))]
    for stem in dict.fromkeys(stems[j] for j in numbered):
        alike = [j for j in numbered if stems[j] == stem]
        if len(alike) >= 2 and _words(stem) & (_HEIGHT | _RUN) and not any(_words(s) & _ACROSS for s in stems):
            clocks = [j for j in range(len(stems)) if j not in alike]
            parts = [Columns([columns.names[k] for k in [*clocks, j]], columns.values[:, [*clocks, j]]) for j in alike]
            found = [(columns.names[j], _positions(part)) for j, part in zip(alike, parts, strict=True)]
            return [(f"{label} {name}".strip(), points) for name, points in found if points is not None]
    points = _positions(columns)
    return [] if points is None else [(label, points)]


def _positions(columns: Columns) -> Points | None:
    """A clock column and a height column; further columns may be the position across, speeds, anything."""
    v, words = columns.values, [_words(name) for name in columns.names]
    clock = next((j for j in range(v.shape[1]) if words[j] & _TIME and _advances(v[:, j])), None)
    frames = next((j for j in range(v.shape[1]) if words[j] & _FRAME and _advances(v[:, j])), None)
    chosen = clock if clock is not None else frames
    if chosen is None:
        chosen = next((j for j in range(v.shape[1]) if _even(v[:, j])), None)
    others = [j for j in range(v.shape[1]) if j not in (clock, frames, chosen) and np.isfinite(v[:, j]).sum() >= 6]
    if chosen is None or not others:
        return None
    named = [j for j in others if words[j] & _HEIGHT]
    if not named:
        ranges = np.nanmax(v, axis=0, initial=-np.inf) - np.nanmin(v, axis=0, initial=np.inf)
        named = sorted((j for j in others if not words[j] & _ACROSS), key=lambda j: -float(ranges[j]))
    height = (named or others)[0]
    across = next((j for j in others if words[j] & _ACROSS), None)
    good = np.isfinite(v[:, chosen]) & np.isfinite(v[:, height])
    if across is not None:
        good &= np.isfinite(v[:, across])
    unit = _unit_factor(columns.names[height], _METRES)
    in_seconds = clock is not None or (frames is None and not _whole(v[good, chosen]))
    order = np.argsort(v[good, chosen], kind="stable")
    if np.all(np.diff(v[good, height][order]) > 0.0):
        return None  # what only grows with its row is a list of times
    y = v[good, height][order] * (unit or 1.0)
    x = v[good, across][order] * (unit or 1.0) if across is not None else np.zeros_like(y)
    seconds = (_unit_factor(columns.names[chosen], _SECONDS) or 1.0) if in_seconds else 1.0
    return Points(v[good, chosen][order] * seconds, x, y, in_seconds=in_seconds, metres=unit is not None)


def _advances(column: Array) -> bool:
    column = column[np.isfinite(column)]
    return len(column) >= 6 and column[-1] > column[0]


def _even(column: Array) -> bool:
    column = column[np.isfinite(column)]
    steps = np.diff(column)
    if len(column) < 6 or not np.all(steps > 0):
        return False
    return float(np.median(np.abs(steps - np.median(steps)))) < 0.05 * float(np.median(steps))


def _whole(column: Array) -> bool:
    return bool(np.all(column == np.round(column)))
