"""Sheets cut into the tables they hold: blocks side by side, repeated headings, drops by number."""

from __future__ import annotations

import re
from itertools import pairwise

from analysis.drop.read.tables import Cell, Grid

_GROUP = {
    "drop", "run", "trial", "test", "set", "versuch", "messung", "fall", "lancio", "prova", "caduta", "essai", "meting",
    "ensayo", "chute",
}  # fmt: skip
_ALONG_ROWS = {"t", "time", "times", "zeit", "tempo", "temps", "dt", "interval", "intervall", "intervallo", "impact"}
_LEAST_ROWS = 3


def blocks_of(grid: Grid) -> list[Grid]:
    """Every table of a sheet; the sheet itself where it holds one."""
    out: list[Grid] = []
    for stacked in _stacked(grid):
        for part in _side_by_side(_upright(stacked)):
            for piece in _repeated(part):
                out += _by_number(piece)
    return out


def _upright(grid: Grid) -> Grid:
    """A table whose drops, or whose times and heights, are rows: turned, so that they are columns."""
    rows = [row for row in grid.rows if any(cell != "" for cell in row)]
    width = max(len(row) for row in rows)
    rows = [[*row, *[""] * (width - len(row))] for row in rows]
    labelled = [isinstance(row[0], str) and row[0] != "" and _count(row[1:]) >= _LEAST_ROWS for row in rows]
    across = sum(labelled) >= max(1, len(rows) - 1) and width > len(rows)
    head = rows[0]
    stems = {re.sub(r"[\W_]*\d+\W*$", "", str(cell)).strip().lower() for cell in head[1:] if cell != ""}
    counted = all(isinstance(cell, str) for cell in head) and len(head) >= _LEAST_ROWS + 1 and len(stems) == 1
    body = [row for row in rows[1:] if _count(row) >= 2]
    if not across and counted and body and stems <= _ALONG_ROWS:
        body = [[f"{next(iter(stems))} {_short(row[0])}", *row[1:]] for row in body]
        return Grid(grid.name, [list(column) for column in zip(*body, strict=True)])
    return Grid(grid.name, [list(column) for column in zip(*rows, strict=True)]) if across else grid


def _count(cells: list[Cell]) -> int:
    return sum(isinstance(cell, float) for cell in cells)


def _stacked(grid: Grid) -> list[Grid]:
    """Tables below each other: cut where the heading comes again, or behind an empty row where the time starts anew."""
    starts: list[int] = []
    head: tuple[str, ...] | None = None
    gap, latest = False, float("-inf")
    for k, row in enumerate(grid.rows):
        texts = tuple(re.sub(r"\d+", "", str(cell)).strip().lower() for cell in row if isinstance(cell, str) and cell)
        numbers = [cell for cell in row if isinstance(cell, float)]
        if not numbers:
            gap = gap or latest > float("-inf")
            if texts and (head is None or texts == head) and len(texts) > 1:
                head = texts
                starts.append(k)
                gap, latest = False, float("-inf")
            continue
        if gap and numbers[0] < latest:
            starts.append(k)
        gap, latest = False, numbers[0]
    if len(starts) < 2:
        return [grid]
    cuts = [0, *starts[1:], len(grid.rows)]
    parts = [grid.rows[a:b] for a, b in pairwise(cuts)]
    full = [part for part in parts if _numbers(part) >= _LEAST_ROWS]
    if len(full) < 2:
        return [grid]
    first = grid.rows[starts[0]]
    named = [part if any(isinstance(c, str) and c for c in part[0]) else [first, *part] for part in full]
    return [_named(grid, f"table {k + 1}", part) for k, part in enumerate(named)]


def _named(grid: Grid, more: str, rows: list[list[Cell]]) -> Grid:
    return Grid(", ".join(part for part in (grid.name, more) if part), rows)


def _side_by_side(grid: Grid) -> list[Grid]:
    """Tables with an empty column between them."""
    width = max(len(row) for row in grid.rows)
    used = [any(j < len(row) and row[j] != "" for row in grid.rows) for j in range(width)]
    groups: list[list[int]] = []
    for j in range(width):
        if used[j]:
            if groups and groups[-1][-1] == j - 1:
                groups[-1].append(j)
            else:
                groups.append([j])
    parts = [[[row[j] if j < len(row) else "" for j in group] for row in grid.rows] for group in groups]
    numeric = [part for part in parts if _numbers(part) >= _LEAST_ROWS]
    if len(numeric) < 2 or len({_pattern(part) for part in numeric}) > 1:
        return [grid]  # columns that differ belong to one table
    return [_named(grid, f"block {k + 1}", part) for k, part in enumerate(numeric)]


def _repeated(grid: Grid) -> list[Grid]:
    """Tables without a gap whose headings repeat: t, y, t, y."""
    head = _heading(grid.rows)
    width = max(len(row) for row in grid.rows)
    if head is None or len(head) < width or not all(isinstance(cell, str) and cell for cell in head):
        return [grid]
    bare = [re.sub(r"[\W\d_]+$", "", re.sub(r"\(.*?\)|\[.*?\]", "", str(cell)).strip().lower()) for cell in head]
    for period in range(2, width // 2 + 1):
        first = bare[:period]
        if width % period == 0 and len(set(first)) == period and bare == first * (width // period):
            return [
                _named(grid, f"block {k // period + 1}", [row[k : k + period] for row in grid.rows])
                for k in range(0, width, period)
            ]
    return [grid]


def _by_number(grid: Grid) -> list[Grid]:
    """One long table with a column that numbers the drops."""
    head = _heading(grid.rows)
    if head is None:
        return [grid]
    for j, cell in enumerate(head):
        words = set(re.split(r"\W+", str(cell).lower()))
        body = [row for row in grid.rows if (j < len(row) and isinstance(row[j], float)) or _text_number(row, j)]
        numbers = [row[j] for row in body]
        values = list(dict.fromkeys(numbers))
        if words & _GROUP and 2 <= len(values) <= len(body) / _LEAST_ROWS and len(head) >= 2:
            at = grid.rows.index(head)
            heads = [[*row[:j], *row[j + 1 :]] for row in grid.rows[: at + 1]]
            return [
                _named(grid, f"{cell} {_short(value)}", heads + [[*r[:j], *r[j + 1 :]] for r in body if r[j] == value])
                for value in values
            ]
    return [grid]


def _text_number(row: list[Cell], j: int) -> bool:
    """A drop named by text, as A or B, beside numbers."""
    return j < len(row) and row[j] != "" and any(isinstance(cell, float) for cell in row)


def _short(value: Cell) -> str:
    return f"{value:g}" if isinstance(value, float) else value


def _heading(rows: list[list[Cell]]) -> list[Cell] | None:
    """The last row of text above the first row of numbers; None where there is none."""
    for k, row in enumerate(rows):
        if any(isinstance(cell, float) for cell in row):
            return rows[k - 1] if k > 0 else None
    return None


def _numbers(rows: list[list[Cell]]) -> int:
    return sum(any(isinstance(cell, float) for cell in row) for row in rows)


def _pattern(rows: list[list[Cell]]) -> tuple[object, ...]:
    """Width and headings without their numbers, by which blocks are alike."""
    head = _heading(rows) or []
    return len(rows[0]), tuple(re.sub(r"\d+", "", str(cell)).strip().lower() for cell in head)
