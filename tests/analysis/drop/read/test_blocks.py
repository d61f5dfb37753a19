"""Tables that hold several drops: sheets, blocks, repeated headings, numbered rows and columns."""

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from analysis.drop.load import load_all
from analysis.drop.read.readings import Points, read_tables
from daq.importers.tables import Sheet, read_sheets
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
    _is_all_three(read_tables([Sheet("", rows)], "x").found)


@pytest.mark.parametrize("merged", [False, True])
def test_balls_and_drops_named_in_columns(merged: bool) -> None:
    """A ball's name and a drop's number in two columns, written in each row or once in a merged cell."""
    rows = [["ball", "trial", "t (s)", "h (m)"]]
    for ball, tall in (("foam", 9.0), ("steel", 8.0)):
        for n in ("a", "b"):
            for k in range(12):
                said = (ball, n) if k == 0 or not merged else ("", "")
                rows.append([*said, k / 10, tall - 0.049 * k * k])
    found = read_tables([Sheet("", rows)], "x").found
    names = ["ball foam, trial a", "ball foam, trial b", "ball steel, trial a", "ball steel, trial b"]
    assert [name for name, _ in found] == names
    assert [path.y[0] for _, path in found] == [9.0, 9.0, 8.0, 8.0]


def test_drops_numbered_in_a_column() -> None:
    """A long table with the drop's number in a column."""
    rows = [["Drop", "Time (s)", "Interval (s)"]]
    rows += [[float(k + 1), *row] for k, times in enumerate(DROPS) for row in _events(times)]
    _is_all_three(read_tables([Sheet("", rows)], "x").found)


def test_a_column_for_each_drop() -> None:
    """Columns of times without intervals, one a drop."""
    rows = [[f"Drop {k}" for k in (1, 2, 3)], *[[float(times[i]) for times in DROPS] for i in range(10)]]
    _is_all_three(read_tables([Sheet("", rows)], "x").found)


def test_heights_of_several_drops_beside_one_clock() -> None:
    """One clock and y1, y2: two paths, each with its own heights."""
    times = np.arange(40) / 100
    rows = [["t (s)", "y1 (m)", "y2 (m)"], *[[float(t), 1 - 4.9 * t * t, 0.8 - 4.9 * t * t] for t in times]]
    found = read_tables([Sheet("", rows)], "x").found
    assert [item.y[0] for _, item in found if isinstance(item, Points)] == [1.0, 0.8]


def test_rebound_heights_are_refused_in_words(tmp_path: Path) -> None:
    """A bounce number and a falling height is neither times nor positions, and the error says what it looks like."""
    (tmp_path / "h.csv").write_text("bounce,height (cm)\n1,80\n2,64\n3,51\n4,41\n5,33\n6,26\n7,21\n", encoding="utf-8")
    with pytest.raises(InputError, match="rebound heights"):
        read_tables(read_sheets(tmp_path / "h.csv"), "h.csv")


def test_a_row_for_each_drop() -> None:
    """Drops as rows, with a row or a column of headings, are read as columns are."""
    named = [["impact", *range(1, 11)], *[[f"Drop {k}", *map(float, times)] for k, times in enumerate(DROPS)]]
    named[0] = ["impact", *[float(k) for k in range(1, 11)]]
    _is_all_three(read_tables([Sheet("", named)], "x").found)
    counted = [["Drop", *[f"t{k}" for k in range(10)]], *[[float(k), *map(float, t)] for k, t in enumerate(DROPS)]]
    _is_all_three(read_tables([Sheet("", counted)], "x").found)


def test_times_and_heights_in_two_rows() -> None:
    """A path in two long rows, time above height, is a path."""
    times = np.arange(40) / 100
    rows = [["t (s)", *map(float, times)], ["y (m)", *map(float, 1 - 4.9 * times * times)]]
    ((_, found),) = read_tables([Sheet("", rows)], "x").found
    assert isinstance(found, Points) and found.y[0] == 1.0 and len(found.clock) == 40


def test_tables_below_each_other() -> None:
    """Tables with the same heading again, under a title each, are drops of their own."""
    rows: list[list[float | str]] = []
    for k, times in enumerate(DROPS):
        rows += [[f"Drop {k + 1}"], ["n", "Time (s)"], *[[float(i), float(t)] for i, t in enumerate(times)], []]
    _is_all_three(read_tables([Sheet("", rows)], "x").found)


def test_what_is_not_read_is_named(tmp_path: Path) -> None:
    """A sheet of positions, a mean and a metronome beside three drops: each is named with its reason."""
    book = openpyxl.Workbook()
    book.active.title = "drops"
    book.active.append(["Drop 1", "Drop 2", "Drop 3", "mean"])
    for row in zip(*DROPS, np.mean(DROPS, axis=0), strict=True):
        book.active.append([float(cell) for cell in row])
    even = book.create_sheet("even")
    for k in range(12):
        even.append([1.0 + 0.5 * k + 0.01 * (k % 2)])
    book.save(tmp_path / "drops.xlsx")
    drops = load_all(tmp_path / "drops.xlsx")
    assert len(drops) == 3
    said = "\n".join(drops[0].not_read)
    assert "drops mean: a mean" in said
    assert "even" in said and "even intervals" in said


def test_thousands_are_read(tmp_path: Path) -> None:
    """Numbers grouped by thousands, "1,004.17" or "1.004,17", are numbers, and no row is lost."""
    rows = "\n".join(f'"{1e3 * t:,.2f}","{k}"' for k, t in enumerate(DROPS[0]))
    (tmp_path / "t.csv").write_text(f"time (ms),n\n{rows}\n", encoding="utf-8")
    ((_, times),) = read_tables(read_sheets(tmp_path / "t.csv"), "x").found
    assert times == pytest.approx(DROPS[0], abs=1e-5)


def test_formulas_without_values_are_refused_in_words(tmp_path: Path) -> None:
    """A workbook that was never opened by a spreadsheet program has formulas only, and the error says so."""
    book = openpyxl.Workbook()
    book.active.append(["time (s)"])
    for k in range(9):
        book.active.append([f"=0.4*{k}"])
    book.save(tmp_path / "f.xlsx")
    with pytest.raises(InputError, match="formulas without saved values"):
        read_sheets(tmp_path / "f.xlsx")


def test_rounded_times_are_whole_frames(tmp_path: Path) -> None:
    """Times of 240 frames a second, rounded to 0.1 ms, are 240 frames a second."""
    frames = np.arange(200)
    fall = np.sqrt(2 * 0.3 / 9.81)
    since = (frames / 240) % (2 * fall) - fall
    rows = "\n".join(f"{k / 240:.4f},{0.3 - 4.905 * s * s:.5f}" for k, s in zip(frames, since, strict=True))
    (tmp_path / "p.csv").write_text(f"t (s),y (m)\n{rows}\n", encoding="utf-8")
    (path,) = load_all(tmp_path / "p.csv")
    assert path.frame_s == pytest.approx(1 / 240, rel=1e-4)
    assert np.ptp(path.clip.frame % 1.0) == pytest.approx(0.0, abs=1e-9)
