"""Heads of text files as instruments write them: oscilloscopes, LabVIEW, dates, Windows-1252."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from daq.importers.formats.columns import parse_map
from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, import_recording
from daq.recording import open_recording
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats

LVM = (
    "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t9\t9\t\n"
    "X0\t0.0E+0\t0.0E+0\t\n***End_of_Header***\t\t\t\nX_Value\tAccelerometer\tDrive\tComment\n"
)
BY_NUMBER = ("accelerometer=1", "drive=2")
NAMED = "time,accelerometer_v,drive_v\n"
Columns = dict[str, Floats]


def test_an_empty_comment_above_columns_that_blanks_separate(tmp_path: Path) -> None:
    """A ``#`` with nothing behind it is no header, and no error either."""
    (tmp_path / "a.txt").write_text("#\n0.0 1.5 2.5\n0.1 1.5 2.5\n", encoding="utf-8")
    assert open_source(tmp_path / "a.txt").names == ("1", "2", "3")


def _rows(columns: Columns, times: list[str] | None = None) -> str:
    """Time, accelerometer and drive, separated by commas."""
    times = times or [f"{t:.6f}" for t in columns["time_s"]]
    pairs = zip(columns["accelerometer_v"], columns["drive_v"], strict=True)
    return "".join(f"{t},{a:.6f},{d:.6f}\n" for t, (a, d) in zip(times, pairs, strict=True))


def _stamps(columns: Columns) -> list[str]:
    """The times as dates with microseconds."""
    start = datetime.datetime(2026, 11, 25, 10)
    return [(start + datetime.timedelta(seconds=float(t))).isoformat(sep=" ") for t in columns["time_s"]]


@pytest.mark.parametrize(
    ("name", "maps"),
    [
        ("scope.csv", BY_NUMBER),
        ("units.csv", BY_NUMBER),
        ("labview.lvm", ()),
        ("dates.csv", ()),
        ("windows.csv", ("accelerometer=Tür (V)",)),
    ],
)
def test_heads_of_instruments_come_in(
    tmp_path: Path, setup: Setup, columns: Columns, name: str, maps: tuple[str, ...]
) -> None:
    """Every row comes in, by the file's own names: no head is taken for numbers, and no row for a head."""
    rows, path = _rows(columns), tmp_path / name
    text = {
        "scope.csv": "x-axis,1,2\n" + rows,
        "units.csv": "x-axis,1,2\nsecond,Volt,Volt\n" + rows,
        "labview.lvm": LVM + rows.replace(",", "\t"),
        "dates.csv": NAMED + _rows(columns, _stamps(columns)),
        "windows.csv": "Zeit (s),Tür (V),drive_v\n" + rows,
    }[name]
    path.write_bytes(text.encode("cp1252"))
    import_recording(open_source(path), tmp_path / "r.h5", setup, "", ImportOptions(parse_map(list(maps))))
    with open_recording(tmp_path / "r.h5") as recording:
        assert recording.rate_hz == pytest.approx(2000.0, rel=1e-9)
        np.testing.assert_allclose(recording.read_v("accelerometer"), columns["accelerometer_v"], atol=1e-6)
        np.testing.assert_allclose(recording.steps["gamma"], [0.2, 0.5, 0.3], rtol=2e-3)
        assert recording.attrs["started"].startswith("2026-11-25T10:00:00" if name == "dates.csv" else "")


def test_a_refusal_names_the_line_of_the_header(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Where no channel is found, or a field is no number, the error names the header's line and how to skip it."""
    path = tmp_path / "a.csv"
    said = r"line 2 was taken for the header, line 3 for the first of the numbers; a # before a line skips it"
    path.write_text("Scope export\nx-axis,1,2\n" + _rows(columns), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        import_recording(open_source(path), tmp_path / "r.h5", setup, "")
    path.write_text("Scope export\n" + NAMED + "0,0.1,0.2\nOVER,0.1,0.2\n", encoding="utf-8")
    with pytest.raises(InputError, match="line 4, column time: wanted a number, got 'OVER'; " + said):
        import_recording(open_source(path), tmp_path / "r.h5", setup, "")
