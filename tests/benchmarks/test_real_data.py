"""The table of what others measured."""

import os
from pathlib import Path

import numpy as np
import pytest

from analysis.drop.falls.fit import Fall
from bench.jobs.drop_test import Request
from benchmarks.real_data import flown_rms, row, rows_of, smoothed_speed, sweep


def test_a_drop_is_a_row_and_a_refusal_says_why(tmp_path: Path) -> None:
    """A row has cause, errors before and after; a file that is no drop test is refused in its row."""
    times = 1.0 + np.concatenate(([0.0], np.cumsum(0.4 * 0.9 ** np.arange(12))))
    (tmp_path / "t.csv").write_text("time (s)\n" + "\n".join(f"{t:.5f}" for t in times), encoding="utf-8")
    found = row("a ball", Request((tmp_path / "t.csv",)))
    assert found.startswith("| a ball | constant_restitution") and found.count(" ms |") == 2
    (tmp_path / "no.csv").write_text("nothing\n", encoding="utf-8")
    assert "refused: no table with numbers" in row("none", Request((tmp_path / "no.csv",)))


def test_harmonics_of_a_sweep_are_found_on_samples_held_out(tmp_path: Path) -> None:
    """A second harmonic of 0.1 g is the error of a pure tone, and goes with the harmonics."""
    t = np.arange(0.0, 2.0, 1.0 / 860.0)
    up = 1.0 + np.sin(2 * np.pi * 40.0 * t) + 0.1 * np.sin(4 * np.pi * 40.0 * t)
    lines = [f"{a:.6f},40,0.5,0,0,0,{z:.5f}" for a, z in zip(t, up, strict=True)]
    (tmp_path / "os_x.csv").write_text("Timestamp,Freq,Drive_Amp,Channel,X,Y,Z\n" + "\n".join(lines), encoding="utf-8")
    cells = sweep(tmp_path / "os_x.csv").split(" | ")
    assert float(cells[3].split()[0]) == pytest.approx(0.1 / np.sqrt(2.0), rel=0.05)
    assert float(cells[4].split()[0]) < 1e-3


def test_a_law_of_the_speed_flies_along_a_drop() -> None:
    """Free fall flown as ``v' = -9.81`` leaves nothing of a drop, and its speed is found from its heights."""
    t = np.arange(0.0, 2.0, 1.0 / 15.0)
    since = np.maximum(t - 0.1, 0.0)
    fall = Fall("a", "a", t, 30.0 - 0.5 * 9.81 * since**2)
    assert flown_rms(np.array([-9.81, 0.0, 0.0]), fall) < 2e-3
    speed, time = smoothed_speed(fall)
    assert speed[time > 0.4] == pytest.approx(-9.81 * (time[time > 0.4] - 0.1), abs=1e-6)


def test_every_measurement_has_a_row() -> None:
    """No file of others' drops is left out of the table."""
    folder = Path(os.environ.get("BOUNCE_DATA", Path(__file__).parents[3] / "shared" / "data"))
    if not (folder / "phyphox").is_dir():
        pytest.skip(f"other people's measurements are not at {folder} (environment variable BOUNCE_DATA)")
    asked = {path for _, request in rows_of(folder) for path in request.files}
    kinds = {".csv", ".xls", ".xlsx", ".wav", ".avi"}
    there = {path for path in folder.rglob("*") if path.suffix in kinds and path.parent.name != "shaker"}
    assert there == asked
