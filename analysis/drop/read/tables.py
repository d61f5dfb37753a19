"""Any table of text or spreadsheet as rows of cells, whatever separator, decimal mark and sheet names it came with.

A table is read by its content, not only by the language of its headings. Numbers may carry a decimal comma;
separators may be tab, semicolon, comma or spaces; legacy and new spreadsheets open alike.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from daq.files.text_table import Cell, number_or_text, text_rows
from daq.setup.errors import InputError

_LARGEST_BYTES = 64 << 20


@dataclass(frozen=True)
class Grid:
    """One sheet."""

    name: str  # the sheet's name; empty for a text file
    rows: list[list[Cell]]  # cells; numbers are converted, blanks are empty strings
    hidden: bool = False  # the sheet is hidden in its workbook


def read_grids(path: Path) -> list[Grid]:
    """All sheets of a spreadsheet, or a text table as the only one.

    Raises
    ------
    InputError
        Unreadable, empty, or a spreadsheet without the reader for it (`pip install shakerbench[tables]`).
    """
    if path.stat().st_size > _LARGEST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size >> 20} MB is no table of a drop; was it the video you meant?")
    with path.open("rb") as file:
        head = file.read(8)
    if not head.startswith((b"PK", b"\xd0\xcf\x11\xe0")):
        grids, formulas = [Grid("", text_rows(path))], False
    else:
        grids, formulas = _workbook(path, head.startswith(b"PK"))
    grids = [grid for grid in grids if any(isinstance(cell, float) for row in grid.rows for cell in row)]
    if not grids and formulas:
        raise InputError(
            f"{path}: its cells are formulas without saved values; open it in a spreadsheet program, save it, and give "
            "it again"
        )
    if not grids:
        raise InputError(
            f"{path}: no table with numbers in it; expected impact times (s), or time and height of a tracked ball: "
            "export the measured columns with their headings"
        )
    return grids


def _workbook(path: Path, is_xlsx: bool) -> tuple[list[Grid], bool]:
    """Sheets of a workbook, and whether it has formulas and no number."""
    try:
        import openpyxl
        import xlrd
    except ImportError as error:
        raise InputError(f"{path}: reading a spreadsheet needs the extra: pip install 'shakerbench[tables]'") from error
    data = path.read_bytes()
    damage = (xlrd.XLRDError, xlrd.compdoc.CompDocError, zipfile.BadZipFile, KeyError, IndexError, ValueError)
    try:
        if is_xlsx:
            new = openpyxl.load_workbook(io.BytesIO(data), data_only=True).worksheets  # a chart's sheet is none of them
            grids = [Grid(s.title, [_cells(row) for row in s.values], s.sheet_state != "visible") for s in new]
        else:
            old = xlrd.open_workbook(file_contents=data, logfile=io.StringIO()).sheets()
            rows = [[_cells(s.row_values(i)) for i in range(s.nrows)] for s in old]
            grids = [Grid(s.name, own, s.visibility != 0) for s, own in zip(old, rows, strict=True)]
    except (*damage, TypeError, AttributeError, OSError) as error:
        raise InputError(f"{path}: damaged spreadsheet ({error}); export it again") from error
    if not is_xlsx or any(isinstance(cell, float) for grid in grids for row in grid.rows for cell in row):
        return grids, False
    written = openpyxl.load_workbook(io.BytesIO(data)).worksheets
    return grids, any(str(cell).startswith("=") for s in written for row in s.values for cell in row)


def _cells(row: Iterable[object]) -> list[Cell]:
    """Cells of a spreadsheet's row; truth values are none."""
    texts = ["" if cell is None or isinstance(cell, bool) else cell for cell in row]
    return [float(cell) if isinstance(cell, int | float) else number_or_text(str(cell)) for cell in texts]
