"""`bench reprocess` and `bench compare` end to end: files, JSON, pictures, exit codes."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from analysis.flights.table import FlightFlag
from analysis.report.figures.recording import FIGURES
from bench.cli import app
from bench.commands.reprocess import IN_WORDS
from daq.files.tables import Block, step_row
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario

RATE_HZ = 20000.0
SHAKER = {
    "os_2026-04-21_15-52-40_vibecheck_sweep_30-220Hz_840Hz.csv": 30.0,
    "os_2026-05-02_15-48-51_vibecheck_sweep_40-200Hz_840Hz.csv": 40.0,
    "os_2026-05-07_13-05-05_sweep_40-200Hz_840Hz_4.0G_360F_0.427kg.csv": 40.0,
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two steps of the ideal rig at c = 1: gamma_peak 1.6 and 4."""
    setup = Setup.model_validate(
        {
            "name": "test",
            "forcing": {"frequency_hz": 25.37},
            "drive": {"g_per_volt": 2.0},
            "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g", "offset_v": 0.0}},
            "ball": {"mass_kg": 0.25},
        }
    )
    plant = Plant(Scenario("ideal"), RATE_HZ, np.random.default_rng(1))
    path = tmp_path_factory.mktemp("run") / "run.h5"
    writer = RecordingWriter(path, setup, profile_text="", channels=plant.channels, backend="simulated", simulated=True)
    n = round(30 * RATE_HZ / 25.37)
    for k, peak in enumerate((1.6, 4.0)):
        t = (k * n + np.arange(n)) / RATE_HZ
        volts = -0.5 * peak * np.sin(2 * np.pi * 25.37 * t) * np.minimum(np.arange(n) / 2000 + k * 0.4, 1.0)
        writer.append(Block(k * n, plant.exchange(volts)))
        writer.mark_step(
            step_row(
                {
                    "first_sample": k * n,
                    "n_samples": n,
                    "settle_samples": n // 3,
                    "gamma": peak / 2,
                    "frequency_hz": 25.37,
                    "ratio": 1,
                    "settle_cycles": 10.0,
                    "cycles": 30.0,
                }
            )[0]
        )
    writer.close()
    return path


def test_reprocess_writes_the_table_the_json_and_the_pictures(recording: Path, tmp_path: Path) -> None:
    """One call gives the CSV with its columns, a JSON with the verdicts, and every picture as PNG and SVG."""
    out = tmp_path / "flights.csv"
    told = tmp_path / "told.json"
    call = ["reprocess", str(recording), "--flights", str(out), "--json", str(told), "--figures", str(tmp_path / "p")]
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 0, result.output
    assert out.read_text(encoding="utf-8").startswith("takeoff_s,landing_s,duration_s,uncertainty_s,")
    payload = json.loads(told.read_text(encoding="utf-8"))
    assert payload["simulated"] is True
    assert [s["verdict"] for s in payload["steps"]] == ["1-cycle", "2-cycle"]
    assert payload["steps"][0]["gamma_peak"] == pytest.approx(1.6, rel=2e-3)
    names = {p.name for p in (tmp_path / "p").iterdir()}
    assert names == {f"{one.name}.{f}" for one in FIGURES for f in ("png", "svg")}
    assert "SIMULATED RIG" in (tmp_path / "p" / "bifurcation.svg").read_text(encoding="utf-8")


def test_a_first_reader_is_told_in_sentences(recording: Path) -> None:
    """The kinds of flights are words with numbers, the delay of the sensors a sentence, and gamma is defined."""
    result = CliRunner().invoke(app, ["reprocess", str(recording)])
    assert result.exit_code == 0, result.output
    assert (
        "intervals in the air; of these " in result.output and "begin where the ball had just landed" in result.output
    )
    assert "gamma = A w^2/g" in result.output
    for word in ("RELAUNCHED", "second witness", "flags:"):
        assert word not in result.output


def test_every_kind_of_flight_has_words() -> None:
    """No flag of a flight is without its words for a reader."""
    assert {flag.name for flag in FlightFlag} == set(IN_WORDS)


def test_compare_says_how_measured_and_predicted_differ(recording: Path) -> None:
    """On the ideal rig the JSON holds the model's flight times next to the measured ones, in agreement."""
    result = CliRunner().invoke(app, ["compare", str(recording), "--json", "-"])
    assert result.exit_code == 0, result.output
    held = json.loads(result.stdout)
    assert held["within_one_sample"] >= 0.99
    assert [s["predicted"] for s in held["steps"]] == ["1-cycle with reset, period 1", "2-cycle with reset, period 2"]
    assert held["steps"][1]["predicted_flight_times_s"] == pytest.approx(
        [7.058725 / (2 * np.pi * 25.37), 5.320300 / (2 * np.pi * 25.37)], abs=5e-5
    )


@pytest.mark.parametrize("command", ["reprocess", "compare"])
def test_what_is_no_recording_is_refused_with_its_name(command: str, tmp_path: Path) -> None:
    """A missing file and a file of something else end with exit status 2 and a message that names them."""
    other = tmp_path / "notes.h5"
    other.write_text("not HDF5", encoding="utf-8")
    for path in (tmp_path / "missing.h5", other):
        result = CliRunner().invoke(app, [command, str(path)])
        assert result.exit_code == 2
        assert path.name in result.output


@pytest.mark.data
@pytest.mark.parametrize("name", list(SHAKER))
def test_somebody_elses_shaker(name: str, tmp_path: Path) -> None:
    """A shaker under amplitude control: every step's acceleration, with harmonics, from the imported CSV."""
    folder = Path(os.environ.get("BOUNCE_DATA", Path(__file__).parents[4] / "shared" / "data")) / "shaker"
    if not (folder / name).is_file():
        pytest.skip(f"other people's measurements are not at {folder}; set BOUNCE_DATA")
    profile = tmp_path / "shaker.toml"
    profile.write_text(
        'name = "shaker"\n[sampling]\nrate_hz = 862.0\n[forcing]\n'
        f"frequency_hz = {SHAKER[name]}\namplitude = [1.0, 0.0]\n"
        '[channels.accelerometer]\nrange_v = 16.0\nsensitivity = 1.0\nunit = "V/g"\nreads_gravity = true\n'
        "[ball]\nmass_kg = 0.427\n",
        encoding="utf-8",
    )
    out, told = tmp_path / "shaker.h5", tmp_path / "told.json"
    roles = ("accelerometer=Z:g", "frequency=Freq", "level=Drive_Amp", "time=Timestamp")
    columns = [word for role in roles for word in ("--map", role)]
    run = CliRunner().invoke(
        app, ["import", str(folder / name), "-p", str(profile), "-o", str(out), "--channel", "0", *columns]
    )
    assert run.exit_code == 0, run.output
    run = CliRunner().invoke(app, ["reprocess", str(out), "--json", str(told)])
    assert run.exit_code == 0, run.output
    payload = json.loads(told.read_text(encoding="utf-8"))
    raw = np.loadtxt(folder / name, delimiter=",", skiprows=1)
    own = raw[raw[:, 3] == 0.0]
    settings = own[np.flatnonzero(np.diff(own[:, 1], prepend=0.0)), 1]
    assert len(payload["steps"]) == settings.size
    for step, set_hz in zip(payload["steps"], settings, strict=True):
        assert step["verdict"] == "undecided"  # nobody watched a ball
        assert step["frequency_hz"] == pytest.approx(set_hz, rel=5e-3)
        # against plain least squares at the file's own uneven times
        rows = own[own[:, 1] == set_hz]
        angle = 2.0 * np.pi * np.outer(rows[:, 0] - rows[0, 0], [t["frequency_hz"] for t in step["tones"]])
        design = np.hstack([np.ones((len(rows), 1)), np.cos(angle), np.sin(angle)])
        fitted, *_ = np.linalg.lstsq(design, rows[:, 6], rcond=None)
        first = np.hypot(fitted[1], fitted[1 + len(step["tones"])])
        assert step["tones"][0]["amplitude_mps2"] / 9.80665 == pytest.approx(first, rel=0.015)
