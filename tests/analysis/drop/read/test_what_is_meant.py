"""Tables whose numbers may mean something else: bare numbers, heights alone, hidden sheets, a second ball."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.drop.load import Path2D, load_all
from analysis.drop.read.readings import read_tables
from daq.importers.tables import Sheet, read_sheets
from daq.setup.errors import InputError

TIMES = 0.5 + np.concatenate(([0.0], np.cumsum(0.4 * 0.8 ** np.arange(9))))


def _column(heading: str, values: list[float]) -> Sheet:
    head = [[heading]] if heading else []
    return Sheet("", [*head, *([value] for value in values)])


def test_bare_numbers_that_shrink_are_not_taken_for_intervals() -> None:
    """Without a heading, rebound heights and intervals look alike, and would give e^2 for e."""
    heights = [0.4 * 0.64**k for k in range(8)]
    with pytest.raises(InputError, match="intervals or rebound heights"):
        read_tables([_column("", heights)], "x")
    found = read_tables([_column("interval (s)", heights)], "x").found[0][1]
    assert isinstance(found, np.ndarray) and np.diff(found) == pytest.approx(heights)


def test_heights_alone_and_a_single_flight_are_refused_as_what_they_are() -> None:
    """The words name rebound heights without times, and two impacts, not milliseconds."""
    with pytest.raises(InputError, match="rebound heights without times"):
        read_tables([_column("height (cm)", [40.0 * 0.64**k for k in range(8)])], "x")
    with pytest.raises(InputError, match="two impacts"):
        read_tables([_column("time (s)", [0.5, 0.9])], "x")


def test_hidden_sheets_and_charts_of_a_workbook(tmp_path: Path) -> None:
    """What a person does not see is not fitted, and is named; a sheet that is a chart holds no drop."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for title, state, times in (("Ball", "visible", TIMES), ("old", "hidden", 0.9 * TIMES)):
        sheet = book.create_sheet(title)
        sheet.sheet_state = state
        for row in ["time (s)"], *([float(t)] for t in times):
            sheet.append(row)
    book.create_chartsheet("chart").add_chart(openpyxl.chart.LineChart())
    book.save(tmp_path / "book.xlsx")
    contents = read_tables(read_sheets(tmp_path / "book.xlsx"), "book.xlsx")
    assert len(contents.found) == 1 and np.asarray(contents.found[0][1]) == pytest.approx(TIMES)
    assert any("old" in words and "hidden" in words for words in contents.not_read)


def test_a_second_ball_beside_the_first_is_named(tmp_path: Path) -> None:
    """Two columns of heights: the first is read, the other is not passed over in silence."""
    clock = np.arange(0.0, 0.8, 0.01)
    fall = np.sqrt(2 * 0.3 / 9.81)
    height = np.where(clock < fall, 0.3 - 4.905 * clock**2, 1.7 * (clock - fall) - 4.905 * (clock - fall) ** 2)
    keep = height >= -1e-9
    rows = [f"{t:.3f},{h:.5f},{0.5 * h:.5f}" for t, h in zip(clock[keep], height[keep], strict=True)]
    file = tmp_path / "two.csv"
    file.write_text("t (s),ball A y (m),ball B y (m)\n" + "\n".join(rows) + "\n", encoding="utf-8")
    item = load_all(file)[0]
    assert isinstance(item, Path2D)
    assert any("ball b" in words and "another ball" in words for words in item.not_read)
