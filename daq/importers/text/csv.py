"""Text files as tables: separated by comma, semicolon or tab, with or without header, plain or gzipped, wide or long.

A line is either parsed whole or named in an error; only blank lines and comments (``#``) are skipped. The file is
read piece by piece; pyarrow parses the numbers, each to the double nearest to it.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from daq.importers.formats.columns import Piece, Source, listed, split_name
from daq.importers.text.text_file import LONGEST_LINE, LongLineError, TextFile
from daq.setup.errors import InputError
from kernels.arrays import Floats, Integers

Item = TypeVar("Item")

_DIALECTS = ((",", "."), (";", ","), ("\t", ","), (None, "."))  # delimiter, and the decimal sign if it is no point
_LISTED = 64
_END_OF_HEADER = "***End_of_Header***"  # of LabVIEW's .lvm
_QUOTED_COMMA = re.compile(rb'"[ \t]*([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)[ \t]*"')


class CsvSource(Source):
    """A text table; ``.gz`` is unpacked on the way.

    Of a long table ``select = {"": value}`` keeps the rows whose selecting column holds ``value``; ``{role: value,
    ...}`` makes the rows of each value a column of their own, named by the role. The selecting column is the one called
    ``channel`` or ``sensor`` unless ``select_column`` names it.
    """

    def __init__(self, path: Path, select: Mapping[str, str], select_column: str | None = None) -> None:
        super().__init__(path)
        self.names = self._base = self._sniff()
        self._select = dict(select)
        self._seen: set[str] = set()
        if select:
            wanted = [select_column.lower()] if select_column else ["channel", "sensor"]
            found = [i for i, name in enumerate(self._base) if name.lower() in wanted]
            if not found:
                raise InputError(
                    f"{path}: --channel needs a column called {' or '.join(wanted)}; it has {listed(self._base)}."
                )
            self._selector = found[0]
            self.names = self._base if "" in select else (*self._base, *select)

    def pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns, some rows at a time (raises InputError, naming the line of what cannot be used)."""
        names = list(dict.fromkeys(names))
        yield from self._selected(names) if self._select else ahead(self._wide(names))

    def _wide(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns of a table that has a column of its own for each."""
        for first, n, block in self._blocks():
            table, rows = self._parsed(block, names, range(first, first + n))
            if len(rows):
                yield Piece(dict(zip(names, table, strict=True)), rows, "line")

    def _selected(self, names: Sequence[str]) -> Iterator[Piece]:
        """Rows of each selected value next to each other; all must come at the same times."""
        shared = [n for n in names if n in self._base]
        columns = list(shared)
        if "" not in self._select:  # the reading of each selected value is a column
            left = [n for i, n in enumerate(self._base) if i != self._selector and n not in shared]
            named = [n for n in left if split_name(n)[0] in ("value", "reading", "volts", "voltage", "v")]
            if len(left) != 1 and len(named) != 1:
                raise InputError(f"{self.path}: which of {', '.join(left)} holds the reading? Call that column value.")
            columns += left if len(left) == 1 else named
        waiting = {role: (np.zeros((len(columns), 0)), np.zeros(0, np.int64)) for role in self._select}
        for first, _, block in self._blocks():
            for role, value in self._select.items():
                numbers, chosen = self._matching(first, str(block, errors="replace"), value)
                if numbers:
                    (table, rows), (more, own) = waiting[role], self._parsed(chosen, columns, numbers)
                    waiting[role] = np.concatenate([table, more], axis=1), np.concatenate([rows, own])
            ready = min(len(rows) for _, rows in waiting.values())
            if ready:
                heads = {role: (table[:, :ready], rows[:ready]) for role, (table, rows) in waiting.items()}
                waiting = {role: (table[:, ready:], rows[ready:]) for role, (table, rows) in waiting.items()}
                yield self._joined(heads, shared)
        for value in self._select.values():
            if not any(_same(seen, value) for seen in self._seen) and len(self._seen) < _LISTED:
                raise InputError(
                    f"{self.path}: no row has {value!r} in column {self._base[self._selector]}; "
                    f"it holds {', '.join(sorted(self._seen))}."
                )
        over = {role: len(rows) for role, (_, rows) in waiting.items() if len(rows)}
        if over:
            raise InputError(f"{self.path}: wanted as many rows of each --channel, but these have more: {over}.")

    def _joined(self, heads: Mapping[str, tuple[Floats, Integers]], shared: Sequence[str]) -> Piece:
        """One piece of the equally many rows of each selected value: shared columns and readings."""
        table, rows = next(iter(heads.values()))
        columns = dict(zip(shared, table, strict=False))
        for role, (own, lines) in heads.items():
            differ = (own[: len(shared)] != table[: len(shared)]).any(axis=0)
            if differ.any():
                raise InputError(
                    f"{self.path}: line {lines[np.argmax(differ)]}: the rows of --channel {role} come at other times "
                    "than the first channel's; import one channel at a time (--channel VALUE)."
                )
            if role:
                columns[role] = own[-1]
        return Piece(columns, rows, "line")

    def _matching(self, first: int, text: str, value: str) -> tuple[list[int], bytes]:
        """Numbers and text of the lines that have ``value`` in the selecting column; ``first`` is the first's."""
        numbers, chosen = [], []
        for number, line in enumerate(text.split("\n"), start=first):
            if not line.strip() or line.lstrip().startswith("#"):
                continue
            fields = _fields(line, self._delimiter)
            if len(fields) <= self._selector:
                self._explain(line, number)
            if len(self._seen) < _LISTED:
                self._seen.add(fields[self._selector].strip())
            if _same(fields[self._selector], value):
                numbers.append(number)
                chosen.append(line.rstrip("\r") + "\n")
        return numbers, "".join(chosen).encode()

    def _sniff(self) -> tuple[str, ...]:
        """Find delimiter, decimal sign, header and the first line of numbers; returns the names of the columns."""
        head: list[str] = []
        with self._refusals("cannot be read as text ({})", head), TextFile(self.path) as file:
            while len(head) < 200 and (line := file.readline()):
                head.append(line.decode(errors="replace").rstrip("\r\n"))
        below = max((i + 1 for i, line in enumerate(head) if line.startswith(_END_OF_HEADER)), default=0)
        comments = [(i, line.lstrip().lstrip("#")) for i, line in enumerate(head) if line.lstrip().startswith("#")]
        skipped = {i for i, _ in comments}
        lines = [(i, line) for i, line in enumerate(head) if i >= below and line.strip() and i not in skipped]
        for delimiter, decimal in _DIALECTS:
            bare = [_unquoted(line.encode(), delimiter).decode() for _, line in lines]
            first = next((k for k in range(len(bare)) if _is_first_row(bare[k : k + 2], delimiter, decimal)), None)
            if first is not None:
                break
        else:
            raise InputError(
                f"{self.path}: no line of numbers among the first {len(head)}; wanted columns separated by comma, "
                "semicolon or tab under a header."
            )
        self._delimiter = delimiter
        self._decimal = "." if delimiter in (",", None) else _decimal_of("\n".join(bare[first:]), delimiter)
        self._first_line = lines[first][0]
        self._is_quoted = any('"' in line for _, line in lines[first:])
        self._width = len(_fields(bare[first], delimiter))
        names = [str(i + 1) for i in range(self._width)]
        self.header = "no line was taken for a header"
        # a header may be a comment: the one next to the numbers
        for i, text in [*lines[:first], *reversed([c for c in comments if c[0] < self._first_line])]:
            titles = _fields(text, delimiter)
            if delimiter is not None and '"' in text:  # what is quoted may hold the delimiter
                titles = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
            if len(titles) == self._width + 1 and titles[-1].strip() in ("", "Comment"):
                titles.pop()
            if len(titles) == self._width and any(split_name(n)[0] for n in titles):
                names = [n.strip().strip('"') for n in titles]
                self.header = f"line {i + 1} was taken for the header"
                break
        if len(set(names)) != len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise InputError(f"{self.path}: the header names {twice!r} twice; give each column its own name.")
        self.header += f", line {self._first_line + 1} for the first of the numbers; a # before a line skips it"
        return tuple(names)

    @contextmanager
    def _refusals(self, what: str, before: Sequence[object]) -> Iterator[None]:
        """Say that the file does not read: ``what``, with the error in its braces, behind the lines ``before``."""
        try:
            yield
        except (OSError, EOFError, zlib.error) as error:
            raise InputError(f"{self.path}: {what.format(error)}.") from error
        except LongLineError as error:
            raise InputError(
                f"{self.path}: line {len(before) + 1} or one near it is longer than {LONGEST_LINE} characters; wanted "
                "a table of numbers, a line for each sample."
            ) from error

    def _blocks(self) -> Iterator[tuple[int, int, memoryview]]:
        """Whole lines, number (from 1) of the first, and how many; a block lasts until the next is asked for."""
        first = self._first_line + 1
        with TextFile(self.path) as file:
            blocks = file.blocks()
            for _ in range(self._first_line):
                file.readline()
            while True:
                with self._refusals("breaks off: {}", range(first - 1)):
                    block = next(blocks, None)
                if block is None:
                    return
                if self._is_quoted:
                    block = memoryview(_unquoted(bytes(block), self._delimiter))
                n = int(np.count_nonzero(np.frombuffer(block, np.uint8) == ord("\n")))
                if not self._decimal and self._delimiter:  # so far all numbers were whole
                    self._decimal = _decimal_of(str(block, errors="replace"), self._delimiter)
                yield first, n, block
                first += n

    def _parsed(
        self, block: bytes | memoryview, names: Sequence[str], numbers: Sequence[int]
    ) -> tuple[Floats, Integers]:
        """Columns (k, n) in the order of ``names``, and the number of each row's line, of the block's ``numbers``."""
        plain = bytes(block)
        # a carriage return within a line would end a row for pyarrow
        if self._delimiter and plain.count(b"\r") == plain.count(b"\r\n"):
            try:
                table = self._columns(pa.py_buffer(plain), names, pa.float64())
            except pa.ArrowInvalid:  # a comment, a date, an error: line by line
                table = None
            if table is not None and table.num_rows == len(numbers):
                return np.array([column.to_numpy() for column in table.columns]), np.asarray(numbers, np.int64)
        lines, own = [], []
        for number, line in zip(numbers, str(block, errors="replace").split("\n"), strict=False):
            if line.strip() and not line.lstrip().startswith("#"):
                fields = _fields(line, self._delimiter)
                if len(fields) != self._width or "\r" in line.rstrip("\r"):
                    self._explain(line, number)
                lines.append("\t".join(fields) if self._delimiter is None else line.rstrip("\r"))
                own.append(number)
        text = pa.py_buffer("".join(line + "\n" for line in lines).encode())
        columns = [self._column(text, name, own) if own else np.zeros(0) for name in names]
        return np.array(columns), np.array(own, np.int64)

    def _columns(self, text: pa.Buffer, names: Sequence[str], kind: pa.DataType) -> pa.Table:
        """The named columns of whole lines, one after another in the order of ``names``; raises ArrowInvalid."""
        places = [str(self._base.index(name)) for name in names]
        return arrow_csv.read_csv(
            text,
            # two threads of this process compute already, see `ahead`
            arrow_csv.ReadOptions(
                use_threads=False, block_size=len(text) + 1, column_names=[str(i) for i in range(self._width)]
            ),
            arrow_csv.ParseOptions(delimiter=self._delimiter or "\t", quote_char=False),
            arrow_csv.ConvertOptions(
                include_columns=places,
                column_types=dict.fromkeys(places, kind),
                decimal_point=self._decimal or ".",
                null_values=[],
                check_utf8=False,
            ),
        )

    def _column(self, text: pa.Buffer, name: str, numbers: Sequence[int]) -> Floats:
        """One column (n,) of lines with these ``numbers``; cell by cell where it holds more than plain numbers."""
        try:
            return np.asarray(self._columns(text, [name], pa.float64()).column(0), float)
        except pa.ArrowInvalid:
            cells = self._columns(text, [name], pa.string()).column(0).to_pylist()
        values = [_number(cell, self._decimal) for cell in cells]
        if None in values:
            k = values.index(None)
            raise InputError(
                f"{self.path}: line {numbers[k]}, column {name}: wanted a number, got {cells[k].strip()!r}; "
                f"{self.header}."
            )
        return np.array(values, float)

    def _explain(self, line: str, number: int) -> NoReturn:
        """Raise the error that says why a line cannot be used."""
        got = len(_fields(line, self._delimiter))
        why = f"wanted {self._width} columns ({listed(self._base)}), got {got}; is the file cut off, or a value gone?"
        if got == self._width:
            why = "a carriage return stands within the line; save the file with one kind of line end"
        raise InputError(f"{self.path}: line {number}: {why}")


def ahead(items: Iterator[Item]) -> Iterator[Item]:
    """The items in order, each made in a thread while the one before it is used; so is an error, raised in its turn.

    pyarrow lets go of the interpreter, so that a second core has something to do.
    """
    with ThreadPoolExecutor(1, "reading ahead") as worker:
        coming = worker.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = worker.submit(next, items, None)
            yield item


def _fields(line: str, delimiter: str | None) -> list[str]:
    return line.rstrip("\r\n").split(delimiter)


def _unquoted(text: bytes, delimiter: str | None) -> bytes:
    """Lines of numbers without quotes; where commas separate columns, one within a quoted number is its point."""
    if delimiter == ",":
        text = _QUOTED_COMMA.sub(rb"\1.\2", text)
    return text.replace(b'"', b" ")


def _number(field: str, decimal: str | None) -> float | None:
    """Value, by Python's parser, of a field that is no plain number; None where it is no number.

    A date with a time of day (ISO 8601; UTC where it names no zone) is seconds since 1970, a time of day
    is seconds since midnight.
    """
    text = field.strip().replace(",", ".") if decimal == "," else field.strip()
    try:
        value = float(text)
        return value if text.isascii() and "_" not in text else None
    except ValueError:
        if ":" not in text:
            return None
    for day in ("", "1970-01-01T"):
        with contextlib.suppress(ValueError):
            when = datetime.datetime.fromisoformat(day + text)
            return (when if when.tzinfo else when.replace(tzinfo=datetime.UTC)).timestamp()
    return None


def _decimal_of(text: str, delimiter: str) -> str:
    """Decimal sign of numbers that no comma separates: the one that is there, a point if both are, else unknown."""
    for sign in ".,":
        number = rf"[ \t]*[+-]?(\d+\{sign}\d*|\{sign}\d+)(e[+-]?\d+)?[ \t]*"
        if re.search(rf"(^|{delimiter}){number}({delimiter}|\r|$)", text, re.MULTILINE | re.IGNORECASE):
            return sign
    return ""


def _is_first_row(lines: list[str], delimiter: str | None, decimal: str) -> bool:
    """Whether the first of two lines holds numbers and is no header, as an oscilloscope's ``x-axis,1,2``."""

    def is_numbers(line: str) -> bool:
        """At least two columns, of which most are numbers (a long table may name its channels)."""
        if delimiter == "," and (";" in line or "\t" in line):
            return False
        fields = [f.replace(decimal, ".") for f in _fields(line, delimiter)]
        return len(fields) > 1 and sum(_number(f, None) is not None for f in fields) * 2 > len(fields)

    if not is_numbers(lines[0]):
        return False
    leads = [_number(_fields(line, delimiter)[0], decimal) for line in lines]
    return leads[0] is not None or len(lines) == 1 or (leads[1] is None and is_numbers(lines[1]))


def _same(field: str, value: str) -> bool:
    """Whether an entry of the selecting column is the selected one, as text or as a number."""
    field, value = field.strip().strip('"'), value.strip()
    try:
        return field.lower() == value.lower() or float(field) == float(value)
    except ValueError:
        return False
