"""Tables that hold several drops: sheets, blocks, repeated headings, numbered rows and columns."""

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from analysis.drop.load import load_all
from analysis.drop.read.readings import Points, read_tables
from analysis.drop.read.tables import Grid, read_grids
from daq.setup.errors import InputError

DROPS = [1.0 + np.concatenate(([0.0], np.cumsum(first * 0.85 ** np.arange(9)))) for first in (0.5, 0.45, 0.4)]


def _events(times: np.ndarray) -> list[list[float]]:
    return [[float(t), float(d)] for t, d in zip(times, np.append(np.diff(times), 0.0), strict=True)]


def _is_all_three(found: list[tuple[str, object]]) -> None:
    assert len(found) == 3
    for (_, times), wanted in zip(found, DROPS, strict=True):
        assert times == pytest.approx(wanted)


def test_every_sheet_of_a_workbook_is_read(tmp_path: Path) -> None:
    """Three sheets are three drops, and a summary that repeats part of one is none."""
    book = openpyxl.Workbook()
    book.active.title = "Summary"
    book.active.append(["Event time (s)", "Interval (s)"])
    for row in _events(DROPS[0][:4]):
        book.active.append(row)
    for k, times in enumerate(DROPS):
        sheet = book.create_sheet(f"Drop {k + 1}")
        sheet.append(["Event time (s)", "Interval (s)"])
        for row in _events(times):
            sheet.append(row)
    book.save(tmp_path / "drops.xlsx")
    drops = load_all(tmp_path / "drops.xlsx")
    assert [drop.name for drop in drops] == [f"drops.xlsx (Drop {k})" for k in (1, 2, 3)]
    assert all(len(drop.bounces.impacts_s) == 10 for drop in drops)


@pytest.mark.parametrize("gap", [0, 1])
def test_blocks_side_by_side(gap: int) -> None:
    """Pairs of columns beside each other, with or without an empty column between, are drops of their own."""
    rows = [["Time (s)", "Interval (s)", *[""] * gap] * 3]
    parts = [_events(times) for times in DROPS]
    rows += [[cell for part in parts for cell in (*part[i], *[""] * gap)] for i in range(10)]
    _is_all_three(read_tables([Grid("", rows)], "x"))


def test_drops_numbered_in_a_column() -> None:
    """A long table with the drop's number in a column."""
    rows = [["Drop", "Time (s)", "Interval (s)"]]
    rows += [[float(k + 1), *row] for k, times in enumerate(DROPS) for row in _events(times)]
    _is_all_three(read_tables([Grid("", rows)], "x"))


def test_a_column_for_each_drop() -> None:
    """Columns of times without intervals, one a drop."""
    rows = [[f"Drop {k}" for k in (1, 2, 3)], *[[float(times[i]) for times in DROPS] for i in range(10)]]
    _is_all_three(read_tables([Grid("", rows)], "x"))


def test_heights_of_several_drops_beside_one_clock() -> None:
    """One clock and y1, y2: two paths, each with its own heights."""
    times = np.arange(40) / 100
    rows = [["t (s)", "y1 (m)", "y2 (m)"], *[[float(t), 1 - 4.9 * t * t, 0.8 - 4.9 * t * t] for t in times]]
    found = read_tables([Grid("", rows)], "x")
    assert [item.y[0] for _, item in found if isinstance(item, Points)] == [1.0, 0.8]


def test_rebound_heights_are_refused_in_words(tmp_path: Path) -> None:
    """A bounce number and a falling height is neither times nor positions, and the error says what it looks like."""
    (tmp_path / "h.csv").write_text("bounce,height (cm)\n1,80\n2,64\n3,51\n4,41\n5,33\n6,26\n7,21\n", encoding="utf-8")
    with pytest.raises(InputError, match="rebound heights"):
        read_tables(read_grids(tmp_path / "h.csv"), "h.csv")
