"""Numbers in text: comma, semicolon or tab separated, with or without a header, plain or gzipped, wide or long.

The rule kept here: a line is either understood whole or named in an error; none is skipped but blank ones and
comments (``#``). The file is never in memory as a whole.
"""

from __future__ import annotations

import gzip
import io
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from daq.errors import InputError
from daq.foreign import Piece, split_name

_DELIMITERS = (",", ";", "\t")
_SNIFFED_LINES = 200
_BLOCK_CHARACTERS = 1 << 22
_LISTED = 64


class CsvSource:
    """A text table.

    Parameters
    ----------
    path
        The file; ``.gz`` is unpacked on the way.
    select
        Long table: ``{"": value}`` keeps the rows whose selecting column holds ``value``; ``{role: value, ...}`` makes
        the rows of each value a column of their own, named by the role.
    select_column
        The selecting column; the default is the one called ``channel`` or ``sensor``.
    """

    rate_hz: float | None = None

    def __init__(self, path: Path, select: Mapping[str, str], select_column: str | None = None) -> None:
        self.path = path
        self.names: tuple[str, ...] = ()
        self._base: tuple[str, ...] = ()
        self._sniff()
        self._select = dict(select)
        self._seen: set[str] = set()
        self._selector = self._find_selector(select_column) if select else -1
        if select and "" not in select:
            self.names = (*self.names, *select)

    def scale(self, name: str, range_v: float) -> tuple[float, float]:
        """Text says what it means: one."""
        return 1.0, 0.0

    def dtype(self, name: str) -> np.dtype[Any]:
        """Text is kept as float64."""
        return np.dtype("<f8")

    def pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns, some rows at a time.

        Raises
        ------
        InputError
            Naming the file and line of what is not a number, missing, or too much.
        """
        if not self._select:
            for numbers, text in self._blocks():
                yield Piece(self._parsed(text, numbers, names), numbers, "line")
        elif "" in self._select:
            for numbers, text in self._blocks():
                where, chosen = self._matching(text, numbers, self._select[""])
                if where:
                    yield Piece(self._parsed(chosen, where, names), where, "line")
            self._refuse_unseen()
        else:
            yield from self._pivoted(names)

    def _open(self) -> io.TextIOWrapper:
        raw: Any = (gzip.open if self.path.suffix.lower() == ".gz" else open)(self.path, "rb")
        return io.TextIOWrapper(raw, encoding="utf-8-sig", errors="replace")

    def _sniff(self) -> None:
        """Find delimiter, decimal sign, header and the first line of numbers."""
        try:
            with self._open() as file:
                head = [line.rstrip("\r\n") for line in itertools.islice(file, _SNIFFED_LINES)]
        except (OSError, EOFError) as error:
            raise InputError(f"{self.path}: cannot be read as text ({error}).") from error
        lines = [(i, line) for i, line in enumerate(head) if line.strip() and not line.lstrip().startswith("#")]
        for delimiter, decimal in ((",", "."), (";", "."), ("\t", "."), (";", ","), ("\t", ","), (None, ".")):
            first = next((k for k, (_, line) in enumerate(lines) if _is_numbers(line, delimiter, decimal)), None)
            if first is not None:
                break
        else:
            raise InputError(
                f"{self.path}: no line of numbers among the first {len(head)}; wanted columns separated by comma, "
                "semicolon or tab under a header."
            )
        self._delimiter, self._decimal = delimiter, decimal
        self._first_line = lines[first][0]
        self._width = len(_fields(lines[first][1], delimiter))
        comments = [line.lstrip().lstrip("#") for line in head[: self._first_line] if line.lstrip().startswith("#")]
        headers = [_fields(line, delimiter) for line in [*(line for _, line in lines[:first]), *reversed(comments)]]
        headers = [h for h in headers if len(h) == self._width]
        named = next((h for h in headers if any(split_name(n)[0] for n in h)), None)
        names = [n.strip().strip('"') for n in named] if named else [str(i + 1) for i in range(self._width)]
        if len(set(names)) != len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise InputError(f"{self.path}: the header names {twice!r} twice; give each column its own name.")
        self.names = self._base = tuple(names)

    def _find_selector(self, name: str | None) -> int:
        wanted = [name.lower()] if name else ["channel", "sensor"]
        for i, known in enumerate(self.names):
            if known.lower() in wanted:
                return i
        raise InputError(
            f"{self.path}: --channel needs a column called {' or '.join(wanted)}; it has {', '.join(self.names)}."
        )

    def _blocks(self) -> Iterator[tuple[Sequence[int], str]]:
        """Line numbers (from 1) and the text of whole lines of numbers, without blank lines and comments."""
        with self._open() as file:
            for _ in range(self._first_line):
                file.readline()
            first = self._first_line + 1
            while True:
                try:
                    text = file.read(_BLOCK_CHARACTERS) + file.readline()
                except (OSError, EOFError) as error:
                    raise InputError(f"{self.path}: breaks off: {error}.") from error
                if not text:
                    return
                text = text if text.endswith("\n") else text + "\n"
                numbers: Sequence[int] = range(first, first + text.count("\n"))
                first += len(numbers)
                if "#" in text or "\n\n" in text or text[0] == "\n":
                    lines = text.splitlines()
                    kept = [i for i, line in enumerate(lines) if line.strip() and line[0] != "#"]
                    numbers, text = [numbers[i] for i in kept], "".join(lines[i] + "\n" for i in kept)
                if text:
                    yield numbers, text

    def _parsed(self, text: str, numbers: Sequence[int], names: Sequence[str]) -> dict[str, NDArray[Any]]:
        positions = [self._base.index(n) for n in names]
        if self._decimal == ",":
            text = text.replace(",", ".")
        if self._delimiter is not None and text.count(self._delimiter) != len(numbers) * (self._width - 1):
            self._explain(text, numbers, positions)
        try:
            table = np.loadtxt(
                io.StringIO(text), delimiter=self._delimiter, usecols=positions, ndmin=2, comments=None
            )
        except ValueError:
            self._explain(text, numbers, positions)
        if len(table) != len(numbers):
            self._explain(text, numbers, positions)
        return {name: table[:, i] for i, name in enumerate(names)}

    def _explain(self, text: str, numbers: Sequence[int], positions: list[int]) -> NoReturn:
        """Say which line cannot be used, and why."""
        for number, line in zip(numbers, text.split("\n"), strict=False):
            fields = _fields(line, self._delimiter)
            if len(fields) != self._width:
                raise InputError(
                    f"{self.path}: line {number}: wanted {self._width} columns ({', '.join(self._base)}), "
                    f"got {len(fields)}; is the file cut off, or a value missing?"
                )
            for i in positions:
                if not _is_number(fields[i]):
                    raise InputError(
                        f"{self.path}: line {number}, column {self._base[i]}: wanted a number, "
                        f"got {fields[i].strip()!r}."
                    )
        raise InputError(f"{self.path}: lines {numbers[0]} to {numbers[-1]} are not a table of numbers.")

    def _matching(self, text: str, numbers: Sequence[int], value: str) -> tuple[list[int], str]:
        """Numbers and text of the lines that have ``value`` in the selecting column."""
        where, chosen = [], []
        for number, line in zip(numbers, text.split("\n"), strict=False):
            fields = _fields(line, self._delimiter)
            if len(fields) <= self._selector:
                self._explain(line, [number], [])
            if len(self._seen) < _LISTED:
                self._seen.add(fields[self._selector].strip())
            if _same(fields[self._selector], value):
                where.append(number)
                chosen.append(line + "\n")
        return where, "".join(chosen)

    def _refuse_unseen(self) -> None:
        """Refuse a selection that no row fits."""
        for value in self._select.values():
            if not any(_same(seen, value) for seen in self._seen) and len(self._seen) < _LISTED:
                raise InputError(
                    f"{self.path}: no row has {value!r} in column {self._base[self._selector]}; "
                    f"it holds {', '.join(sorted(self._seen))}."
                )

    def _pivoted(self, names: Sequence[str]) -> Iterator[Piece]:
        """Rows of each selected value side by side; all must come at the same times."""
        shared = [n for n in names if n in self._base]
        value_column = self._value_column(shared)
        waiting: dict[str, list[tuple[int, dict[str, float]]]] = {role: [] for role in self._select}
        for numbers, text in self._blocks():
            for role, value in self._select.items():
                where, chosen = self._matching(text, numbers, value)
                if where:
                    table = self._parsed(chosen, where, [*shared, value_column])
                    rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
                    waiting[role] += list(zip(where, rows, strict=True))
            ready = min(len(rows) for rows in waiting.values())
            if ready:
                heads = {role: rows[:ready] for role, rows in waiting.items()}
                waiting = {role: rows[ready:] for role, rows in waiting.items()}
                yield self._side_by_side(heads, shared, value_column)
        self._refuse_unseen()
        left = {role: len(rows) for role, rows in waiting.items() if rows}
        if left:
            raise InputError(f"{self.path}: wanted as many rows of each --channel, but these have more: {left}.")

    def _side_by_side(
        self, heads: dict[str, list[tuple[int, dict[str, float]]]], shared: list[str], value_column: str
    ) -> Piece:
        first = next(iter(heads.values()))
        columns = {n: np.array([row[n] for _, row in first]) for n in shared}
        for role, rows in heads.items():
            for (line, row), (_, reference) in zip(rows, first, strict=True):
                if any(row[n] != reference[n] for n in shared):
                    raise InputError(
                        f"{self.path}: line {line}: the rows of --channel {role} come at other times than the first "
                        "channel's; import one channel at a time (--channel VALUE)."
                    )
            columns[role] = np.array([row[value_column] for _, row in rows])
        return Piece(columns, [line for line, _ in first], "line")

    def _value_column(self, shared: list[str]) -> str:
        left = [n for i, n in enumerate(self._base) if i != self._selector and n not in shared]
        if len(left) == 1:
            return left[0]
        named = [n for n in left if split_name(n)[0] in ("value", "reading", "volts", "voltage", "v")]
        if len(named) != 1:
            raise InputError(f"{self.path}: which of {', '.join(left)} holds the reading? Call that column value.")
        return named[0]


def _fields(line: str, delimiter: str | None) -> list[str]:
    return line.rstrip("\r\n").split(delimiter)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_numbers(line: str, delimiter: str | None, decimal: str) -> bool:
    """Whether a line holds at least two columns of which most are numbers (a long table may name its channels)."""
    fields = _fields(line, delimiter)
    if decimal != ".":
        fields = [f.replace(decimal, ".") for f in fields]
    return len(fields) > 1 and sum(_is_number(f) for f in fields) * 2 > len(fields)


def _same(field: str, value: str) -> bool:
    field, value = field.strip().strip('"'), value.strip()
    return field.lower() == value.lower() or (_is_number(field) and _is_number(value) and float(field) == float(value))
