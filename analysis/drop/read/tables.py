"""Any table of text or spreadsheet as rows of cells, whatever separator, decimal mark and sheet names it came with.

A table is read by its content, never by the language of its headings alone. Numbers may carry a
decimal comma; separators may be tab, semicolon, comma or spaces; legacy and new spreadsheets open alike.
"""

from __future__ import annotations

import csv
import io
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

from daq.setup.errors import InputError

Cell = float | str
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_GROUPED = (re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d*"), re.compile(r"[+-]?\d{1,3}([.' \u202f\xa0]\d{3})+,\d*"))
_LARGEST_BYTES = 64 << 20


@dataclass(frozen=True)
class Grid:
    """One sheet.

    Attributes
    ----------
    name : str
        The sheet's name; empty for a text file.
    rows : list of lists of float or str
        Cells; numbers are converted, blanks are empty strings.
    hidden : bool
        The sheet is hidden in its workbook.
    """

    name: str
    rows: list[list[Cell]]
    hidden: bool = False


def read_grids(path: Path) -> list[Grid]:
    """All sheets of a spreadsheet, or a text table as the only one.

    Raises
    ------
    InputError
        Unreadable, empty, or a spreadsheet without the reader for it (`pip install shakerbench[tables]`).
    """
    if path.stat().st_size > _LARGEST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size >> 20} MB is no table of a drop; was it the video you meant?")
    head = path.read_bytes()[:8]
    if head.startswith(b"PK"):
        grids = _read_xlsx(path)
    elif head.startswith(b"\xd0\xcf\x11\xe0"):
        grids = _read_xls(path)
    else:
        grids = [Grid("", _text_rows(_decode(path)))]
    grids = [grid for grid in grids if any(isinstance(cell, float) for row in grid.rows for cell in row)]
    if not grids:
        if head.startswith(b"PK") and _formulas(path):
            raise InputError(
                f"{path}: its cells are formulas without saved values; open it in a spreadsheet program, save it, and "
                "give it again"
            )
        raise InputError(
            f"{path}: no table with numbers in it; expected impact times (s), or time and height of a tracked ball: "
            "export the measured columns with their headings"
        )
    return grids


def _read_xlsx(path: Path) -> list[Grid]:
    try:
        import openpyxl
    except ImportError as error:
        raise InputError(f"{path}: reading a spreadsheet needs the extra: pip install 'shakerbench[tables]'") from error
    try:
        book = openpyxl.load_workbook(io.BytesIO(path.read_bytes()), data_only=True)
    except (zipfile.BadZipFile, KeyError, ValueError, TypeError, AttributeError, OSError) as error:
        raise InputError(f"{path}: damaged spreadsheet ({error}); export it again") from error
    return [
        Grid(sheet.title, [[_cell(c) for c in row] for row in sheet.values], sheet.sheet_state != "visible")
        for sheet in book.worksheets  # a sheet that is a chart holds no cells
    ]


def _formulas(path: Path) -> bool:
    """Whether a workbook has formulas."""
    import openpyxl

    book = openpyxl.load_workbook(io.BytesIO(path.read_bytes()))
    return any(str(cell).startswith("=") for sheet in book.worksheets for row in sheet.values for cell in row)


def _read_xls(path: Path) -> list[Grid]:
    try:
        import xlrd
    except ImportError as error:
        raise InputError(f"{path}: reading a spreadsheet needs the extra: pip install 'shakerbench[tables]'") from error
    try:
        book = xlrd.open_workbook(file_contents=path.read_bytes(), logfile=_Quiet())
    except (xlrd.XLRDError, xlrd.compdoc.CompDocError, IndexError, ValueError, OSError) as error:
        raise InputError(f"{path}: damaged spreadsheet ({error}); export it again") from error
    return [
        Grid(s.name, [[_cell(c) for c in s.row_values(i)] for i in range(s.nrows)], s.visibility != 0)
        for s in book.sheets()
    ]


class _Quiet:
    """Where xlrd writes its remarks."""

    def write(self, _text: str) -> None:
        """Drop them."""


def _cell(value: object) -> Cell:
    if isinstance(value, bool) or value is None:
        return ""
    if isinstance(value, (int, float)):
        return float(value)
    return number_or_text(str(value))


def number_or_text(text: str) -> Cell:
    """A number if the whole cell is one, with point or comma; else the stripped text."""
    text = text.strip().strip('"').strip().replace("\N{MINUS SIGN}", "-")
    if _NUMBER.fullmatch(text):
        return float(text.replace(",", "."))
    if _GROUPED[0].fullmatch(text):
        return float(text.replace(",", ""))
    if _GROUPED[1].fullmatch(text):
        return float(re.sub(r"[.' \u202f\xa0]", "", text).replace(",", "."))
    return text


def _decode(path: Path) -> str:
    raw = path.read_bytes()
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return raw.decode("utf-16", errors="replace")
    if b"\x00" in raw[:4096]:
        raise InputError(f"{path}: neither text nor a known spreadsheet, sound, video or recording; is it damaged?")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _text_rows(text: str) -> list[list[Cell]]:
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    separator = _separator(lines)
    if separator is None:
        cut = [line.split() for line in lines]
    else:
        cut = [next(csv.reader([line], delimiter=separator)) for line in lines]
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
