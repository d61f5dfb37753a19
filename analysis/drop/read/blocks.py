"""Sheets cut into the tables they hold: blocks side by side, repeated headings, drops by number."""

from __future__ import annotations

import re
from itertools import pairwise

from daq.importers.tables import Cell, Sheet

Rows = list[list[Cell]]

_GROUP = {
    "drop", "run", "trial", "test", "set", "versuch", "messung", "fall", "lancio", "prova", "caduta", "essai",
    "meting", "ensayo", "chute", "ball", "kugel", "palla", "object",
}  # fmt: skip
_ALONG_ROWS = {"t", "time", "times", "zeit", "tempo", "temps", "dt", "interval", "intervall", "intervallo", "impact"}
_LEAST_ROWS = 3


def blocks_of(grid: Sheet) -> list[Sheet]:
    """Every table of a sheet; the sheet itself where it holds one."""
    stacked = [_upright(part) for part in _stacked(grid)]
    blocks = [part for one in stacked for part in _side_by_side(one)]
    repeated = [part for one in blocks for part in _repeated(one)]
    return [part for one in repeated for part in _by_number(one)]


def _upright(grid: Sheet) -> Sheet:
    """A table whose drops, or whose times and heights, are rows: turned, so that they are columns."""
    rows = [row for row in grid.rows if any(cell != "" for cell in row)]
    width = max(len(row) for row in rows)
    rows = [[*row, *[""] * (width - len(row))] for row in rows]
    labelled = [isinstance(row[0], str) and row[0] != "" and _count(row[1:]) >= _LEAST_ROWS for row in rows]
    if width > len(rows) and sum(labelled) >= max(1, len(rows) - 1):
        return Sheet(grid.name, [list(column) for column in zip(*rows, strict=True)])
    head = rows[0]
    stems = {re.sub(r"[\W_]*\d+\W*$", "", str(cell)).strip().lower() for cell in head[1:] if cell != ""}
    counted = all(isinstance(cell, str) for cell in head) and len(head) >= _LEAST_ROWS + 1 and len(stems) == 1
    body = [row for row in rows[1:] if _count(row) >= 2]
    if counted and body and stems <= _ALONG_ROWS:  # t1, t2, t3, ...: a drop in each row
        named = [[f"{min(stems)} {_short(row[0])}", *row[1:]] for row in body]
        return Sheet(grid.name, [list(column) for column in zip(*named, strict=True)])
    return grid


def _stacked(grid: Sheet) -> list[Sheet]:
    """Tables below each other: cut where the heading comes again, or after an empty row where the time starts anew."""
    starts: list[int] = []
    head: tuple[str, ...] | None = None
    gap, latest = False, float("-inf")
    for k, row in enumerate(grid.rows):
        texts = tuple(_bare(cell) for cell in row if isinstance(cell, str) and cell)
        numbers = [cell for cell in row if isinstance(cell, float)]
        if numbers:
            if gap and numbers[0] < latest:
                starts.append(k)
            gap, latest = False, numbers[0]
        elif len(texts) > 1 and (head is None or texts == head):
            head, gap, latest = texts, False, float("-inf")
            starts.append(k)
        else:
            gap = gap or latest > float("-inf")
    parts = [grid.rows[a:b] for a, b in pairwise([0, *starts[1:], len(grid.rows)])]
    full = [part for part in parts if _holds_numbers(part)]
    if len(starts) < 2 or len(full) < 2:
        return [grid]
    first = grid.rows[starts[0]]
    named = [part if any(isinstance(c, str) and c for c in part[0]) else [first, *part] for part in full]
    return [_named(grid, f"table {k + 1}", part) for k, part in enumerate(named)]


def _side_by_side(grid: Sheet) -> list[Sheet]:
    """Tables with an empty column between them; columns that differ belong to one table."""
    width = max(len(row) for row in grid.rows)
    used = [any(j < len(row) and row[j] != "" for row in grid.rows) for j in range(width)]
    edges = [j for j in range(width + 1) if (j < width and used[j]) != (j > 0 and used[j - 1])]
    groups = [range(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    parts = [[[row[j] if j < len(row) else "" for j in group] for row in grid.rows] for group in groups]
    full = [part for part in parts if _holds_numbers(part)]
    kinds = {(len(part[0]), *(_bare(cell) for cell in _heading(part) or [])) for part in full}
    if len(full) < 2 or len(kinds) > 1:
        return [grid]
    return [_named(grid, f"block {k + 1}", part) for k, part in enumerate(full)]


def _repeated(grid: Sheet) -> list[Sheet]:
    """Tables without a gap whose headings repeat: t, y, t, y."""
    head = _heading(grid.rows)
    width = max(len(row) for row in grid.rows)
    if head is None or len(head) < width or not all(isinstance(cell, str) and cell for cell in head):
        return [grid]
    bare = [re.sub(r"[\W\d_]+$", "", re.sub(r"\(.*?\)|\[.*?\]", "", str(cell)).strip().lower()) for cell in head]
    for period in range(2, width // 2 + 1):
        first = bare[:period]
        if width % period == 0 and len(set(first)) == period and bare == first * (width // period):
            parts = [[row[k : k + period] for row in grid.rows] for k in range(0, width, period)]
            return [_named(grid, f"block {k + 1}", part) for k, part in enumerate(parts)]
    return [grid]


def _by_number(grid: Sheet) -> list[Sheet]:
    """One long table with columns that number the drops, or name them or their balls; a merged cell counts downward."""
    head = _heading(grid.rows) or []
    for j, cell in enumerate(head):
        if len(head) < 2 or not set(re.split(r"\W+", str(cell).lower())) & _GROUP:
            continue
        body = [list(row) for row in grid.rows if j < len(row) and _count(row)]
        if body and isinstance(body[0][j], str) and body[0][j]:
            for before, row in pairwise(body):
                row[j] = before[j] if row[j] == "" else row[j]
        body = [row for row in body if row[j] != ""]
        values = list(dict.fromkeys(row[j] for row in body))
        if 2 <= len(values) <= len(body) / _LEAST_ROWS:
            above = grid.rows[: grid.rows.index(head) + 1]
            parts = [above + [row for row in body if row[j] == value] for value in values]
            said = [_short(value) for value in values]
            said = [own if own.lower().startswith(str(cell).lower()) else f"{cell} {own}" for own in said]
            named = [
                _named(grid, own, [[*row[:j], *row[j + 1 :]] for row in part])
                for own, part in zip(said, parts, strict=True)
            ]
            return [one for part in named for one in _by_number(part)]
    return [grid]


def _count(cells: list[Cell]) -> int:
    return sum(isinstance(cell, float) for cell in cells)


def _holds_numbers(rows: Rows) -> bool:
    return sum(_count(row) > 0 for row in rows) >= _LEAST_ROWS


def _named(grid: Sheet, more: str, rows: Rows) -> Sheet:
    return Sheet(", ".join(part for part in (grid.name, more) if part), rows)


def _short(value: Cell) -> str:
    return f"{value:g}" if isinstance(value, float) else value


def _bare(cell: Cell) -> str:
    """A heading without its numbers."""
    return re.sub(r"\d+", "", str(cell)).strip().lower()


def _heading(rows: Rows) -> list[Cell] | None:
    """The last row of text above the first row of numbers; None where there is none."""
    first = next((k for k, row in enumerate(rows) if _count(row)), 0)
    return rows[first - 1] if first > 0 else None
