"""Tables of text or spreadsheets as cells, and as columns of numbers under headings with units. Decision 395.

Separators may be tab, semicolon, comma or blanks; numbers may carry a decimal comma; old and new workbooks open alike.
A table here fits in memory. Recordings of any length are streamed by `daq.importers.text.csv`.
"""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.importers.text.text_file import encoding_of
from daq.setup.errors import InputError
from kernels.arrays import Floats

Cell = float | str

LARGEST_BYTES = 64 << 20
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_COMMA_GROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d*")
_POINT_GROUPED = re.compile(r"[+-]?\d{1,3}([.' \u202f\xa0]\d{3})+,\d*")
_UNIT = re.compile(r"[(\[]\s*([^)\]]+?)\s*[)\]]|/\s*([^\s/]+)\s*$|[_ ]([^\s_()\[\]]+)\s*$")
_UNITS = {
    "m", "cm", "mm", "s", "sec", "ms", "us", "px", "pixel", "pixels", "frame", "frames", "deg", "rad", "hz", "kg", "mv",
    "ft", "in", "1", "",
}  # fmt: skip
_WORKBOOKS = (b"PK", b"\xd0\xcf\x11\xe0")  # beginnings of .xlsx and .xls


@dataclass(frozen=True)
class Sheet:
    """One sheet of a workbook, or a text table, whose name is empty."""

    name: str
    rows: list[list[Cell]]  # cells by row; an empty cell is an empty text
    hidden: bool = False  # whether the workbook hides the sheet


@dataclass(frozen=True)
class Table:
    """Columns of numbers."""

    # of each column in lower case, with its unit where a row of units stands below; empty where there is none
    headings: list[str]
    values: Floats  # (rows, columns) NaN where a cell holds no number

    def numbers(self, column: int) -> Floats:
        """The numbers of a column, shape (n,)."""
        return np.asarray(self.values[np.isfinite(self.values[:, column]), column])


def number_or_text(text: str) -> Cell:
    """A number if the whole cell is one, with point or comma; else the stripped text."""
    text = text.strip().strip('"').strip().replace("\N{MINUS SIGN}", "-")
    if _NUMBER.fullmatch(text):
        return float(text.replace(",", "."))
    if _COMMA_GROUPED.fullmatch(text):
        return float(text.replace(",", ""))
    if _POINT_GROUPED.fullmatch(text):
        return float(re.sub(r"[.' \u202f\xa0]", "", text).replace(",", "."))
    return text


def split_unit(heading: str, units: Container[str]) -> tuple[str, str]:
    """A heading without its unit, and the unit; empty where it states none of ``units``.

    >>> split_unit("height [cm]", ("cm",)), split_unit("y / cm", ("cm",)), split_unit("t_ms", ("s",))
    (('height', 'cm'), ('y', 'cm'), ('t_ms', ''))
    """
    for found in _UNIT.finditer(heading):
        unit = next(part for part in found.groups() if part is not None)
        if unit in units:
            return (heading[: found.start()] + heading[found.end() :]).strip(), unit
    return heading, ""


def read_sheets(path: Path) -> list[Sheet]:
    """Sheets of a workbook (.xlsx, .xls), or a text table as the only one; those without a number are left out.

    Raises `InputError` for a table that is too large, unreadable or without numbers, or a workbook without its reader
    (`pip install shakerbench[tables]`).
    """
    if (size := path.stat().st_size) > LARGEST_BYTES:
        raise InputError(
            f"{path}: {size >> 20} MB is no table; wanted columns of numbers under their headings, at most "
            f"{LARGEST_BYTES >> 20} MB"
        )
    data, formulas = path.read_bytes(), False
    if data.startswith(_WORKBOOKS):
        sheets, formulas = _workbook(path, data)
    else:
        sheets = [Sheet("", text_rows(path, data))]
    sheets = [sheet for sheet in sheets if _holds_numbers(sheet)]
    if not sheets and formulas:
        raise InputError(
            f"{path}: its cells are formulas without saved values; open it in a spreadsheet program, save it, and give "
            "it again"
        )
    if not sheets:
        raise InputError(
            f"{path}: no table with numbers in it; expected columns of numbers under their headings: export the "
            "measured columns with their headings"
        )
    return sheets


def table_of(rows: Sequence[Sequence[Cell]]) -> Table:
    """Headings and numbers: data are the rows with at least half as many numbers as most have."""
    counts = np.array([sum(isinstance(cell, float) for cell in row) for row in rows])
    data = np.flatnonzero(counts >= max(1, 0.5 * int(np.median(counts[counts > 0])))).tolist()
    values = np.full((len(data), max(len(rows[i]) for i in data)), np.nan)
    for k, i in enumerate(data):
        for j, cell in enumerate(rows[i]):
            if isinstance(cell, float):
                values[k, j] = cell
    heads = _headings([row for row in rows[: data[0]] if row])
    names = [" ".join(str(row[j]) for row in heads if j < len(row)).strip().lower() for j in range(values.shape[1])]
    return Table(names, values)


def _headings(above: list[Sequence[Cell]]) -> list[Sequence[Cell]]:
    """The fullest of the rows above the data, and a row of units next to it."""

    def holds_units(row: Sequence[Cell]) -> bool:
        bare = [re.sub(r"[\^*²]\d*$", "", str(c).strip("()[] ").lower()) for c in row if str(c)]  # m/s^2 is one, too
        return all(part.strip("^2²") in _UNITS for text in bare for part in re.split(r"[/·* ]", text))

    if not above:
        return []
    full = max(range(len(above)), key=lambda i: (sum(bool(str(cell)) for cell in above[i]), i))
    if full > 0 and holds_units(above[full]):
        return [above[full - 1], above[full]]
    below = full + 1 < len(above) and holds_units(above[full + 1])
    return [above[full], above[full + 1]] if below else [above[full]]


def _holds_numbers(sheet: Sheet) -> bool:
    return any(isinstance(cell, float) for row in sheet.rows for cell in row)


def _workbook(path: Path, data: bytes) -> tuple[list[Sheet], bool]:
    """Sheets of a workbook, and whether it has formulas and no number."""
    try:
        import openpyxl
        import xlrd
    except ImportError as error:
        raise InputError(f"{path}: reading a spreadsheet needs the extra: pip install 'shakerbench[tables]'") from error

    def cells(row: Iterable[object]) -> list[Cell]:
        texts = ["" if cell is None or isinstance(cell, bool) else cell for cell in row]  # truth values are no numbers
        return [float(cell) if isinstance(cell, int | float) else number_or_text(str(cell)) for cell in texts]

    damage = (xlrd.XLRDError, xlrd.compdoc.CompDocError, zipfile.BadZipFile, KeyError, IndexError, ValueError)
    is_new = data.startswith(_WORKBOOKS[0])
    try:
        if is_new:
            new = openpyxl.load_workbook(io.BytesIO(data), data_only=True).worksheets  # a chart's sheet is none of them
            sheets = [Sheet(s.title, [cells(row) for row in s.values], s.sheet_state != "visible") for s in new]
        else:
            old = xlrd.open_workbook(file_contents=data, logfile=io.StringIO()).sheets()
            rows = [[cells(s.row_values(i)) for i in range(s.nrows)] for s in old]
            sheets = [Sheet(s.name, own, s.visibility != 0) for s, own in zip(old, rows, strict=True)]
    except (*damage, TypeError, AttributeError, OSError) as error:
        raise InputError(f"{path}: damaged spreadsheet ({error}); export it again") from error
    if not is_new or any(map(_holds_numbers, sheets)):
        return sheets, False
    written = openpyxl.load_workbook(io.BytesIO(data)).worksheets
    return sheets, any(str(cell).startswith("=") for s in written for row in s.values for cell in row)


def text_rows(path: Path, data: bytes) -> list[list[Cell]]:
    """Rows of a text table; blank lines and comments (``#``) are left out (raises InputError: the file is no text)."""
    encoding = encoding_of(data)
    if encoding != "utf-16" and b"\x00" in data[:4096]:
        raise InputError(f"{path}: neither text nor a known spreadsheet, sound, video or recording; is it damaged?")
    text = data.decode(encoding, errors="replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    separator = _separator(lines)
    cut = [line.split() if separator is None else next(csv.reader([line], delimiter=separator)) for line in lines]
    return [[number_or_text(cell) for cell in row] for row in cut]


def _separator(lines: list[str]) -> str | None:
    """Tab, semicolon or comma, or None for spaces; a comma inside every number is its decimal mark."""
    body = [line for line in lines if re.match(r"\s*[\"+\-.,\d]", line)] or lines
    for mark in ("\t", ";"):
        if sum(mark in line for line in body) > 0.5 * len(body):
            return mark
    tokens = [line.replace('"', " ").split() for line in body]
    plain = sum(all(_NUMBER.fullmatch(token) or token == "*" for token in row) for row in tokens)
    several = sum(len(row) > 1 for row in tokens)
    commas = sum("," in line for line in body)
    headed = any("," in line for line in lines if line not in body)
    if commas > 0.5 * len(body) and (plain < 0.5 * len(body) or (several < 0.5 * len(body) and headed)):
        return ","
    if several > 0.5 * len(body):
        return None
    return "," if commas > 0.5 * len(body) and (headed or plain < len(body)) else "\t"
