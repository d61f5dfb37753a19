"""Tables as cells and as columns: separators, decimal commas, workbooks, headings and units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from daq.importers.tables import read_sheets, split_unit, table_of
from daq.setup.errors import InputError

ROWS = [[0.0, 1.5], [0.25, -2.75], [0.5, 1250.0]]


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_any_separator_and_encoding_gives_the_same_columns(tmp_path: Path, separator: str, encoding: str) -> None:
    """Headings, units below them and numbers are read alike, a decimal comma too where commas do not separate."""
    lines = [["Zeit", "Höhe"], ["(s)", "(mm)"], *([f"{x:g}" for x in row] for row in ROWS)]
    text = "\n".join(separator.join(line) for line in lines)
    if separator != ",":
        text = text.replace(".", ",")
    (tmp_path / "t.csv").write_bytes(text.encode(encoding))
    (sheet,) = read_sheets(tmp_path / "t.csv")
    table = table_of(sheet.rows)
    assert table.headings == ["zeit (s)", "höhe (mm)"]
    assert np.array_equal(table.values, ROWS)


def test_sheets_of_a_workbook(tmp_path: Path) -> None:
    """Each sheet with numbers is one table, a hidden one says so, and what is no number is NaN."""
    book = openpyxl.Workbook()
    for row in (["t (s)", "y"], [0.0, 1], [0.1, None], [0.2, "3,5"]):
        book.active.append(row)
    book.create_sheet("notes").append(["only text"])
    other = book.create_sheet("hidden")
    other.append([1])
    other.sheet_state = "hidden"
    book.save(tmp_path / "t.xlsx")
    first, second = read_sheets(tmp_path / "t.xlsx")
    assert (second.name, first.hidden, second.hidden) == ("hidden", False, True)
    table = table_of(first.rows)
    assert np.array_equal(table.numbers(1), [1.0, 3.5]) and np.isnan(table.values[1, 1])


@pytest.mark.parametrize(
    ("heading", "split"),
    [
        ("height [cm]", ("height", "cm")),
        ("y / cm", ("y", "cm")),
        ("y_cm", ("y", "cm")),
        ("y (cm) 2", ("y  2", "cm")),
        ("plate_accel_m/s^2", ("plate_accel", "m/s^2")),
        ("t (h)", ("t (h)", "")),
    ],
)
def test_the_unit_of_a_heading(heading: str, split: tuple[str, str]) -> None:
    """In brackets, behind a stroke, or as the last word; one that is not known stays in the heading."""
    assert split_unit(heading, ("cm", "m/s^2")) == split


def test_what_holds_no_numbers_is_refused(tmp_path: Path) -> None:
    """The error says what was wanted."""
    (tmp_path / "t.csv").write_text("nothing\nhere\n", encoding="utf-8")
    with pytest.raises(InputError, match="no table with numbers in it; expected columns of numbers under"):
        read_sheets(tmp_path / "t.csv")
