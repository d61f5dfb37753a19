"""`bench ramp` on the simulated rig: recorded, refused, interrupted."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.profiles.find import shipped_folder
from daq.recording import open_recording
from tests.fakes.commanded_drive import commanded, fades_of_changes

SIMULATED = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """The simulated rig's profile with three short steps."""
    path = tmp_path / "short.toml"
    text = SIMULATED.replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.4, 0.7, 0.9]")
    text = text.replace("_cycles = 10", "_cycles = 3").replace("_cycles = 20", "_cycles = 4")
    path.write_text(text, encoding="utf-8")
    return path


def bench(*arguments: object):
    """Call the command line in process."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_a_ramp_is_recorded(short: Path, tmp_path: Path) -> None:
    """The recording carries profile, note, free keys and the hash alone; its drive is what was commanded."""
    out = tmp_path / "rec.h5"
    options = ("--note", "first light", "--set", "knob=3", "--set", "who=me", "--json", "-")
    result = bench("ramp", short, "--out", out, *options)
    assert result.exit_code == 0, result.stderr
    summary = json.loads(result.stdout)
    assert (summary["how"], summary["steps_driven"], summary["simulated"]) == ("complete", 3, True)
    with open_recording(out) as recording:
        attributes = recording.attrs
        assert attributes["note"] == "first light" and attributes["extra"] == {"knob": 3.0, "who": "me"}
        assert attributes["profile_text"] == short.read_text(encoding="utf-8")
        assert attributes["simulated"] and len(attributes["scenario_sha256"]) == 64
        fades = fades_of_changes(recording.setup, recording.drive_changes)
        asked = commanded(recording.setup, fades, 0, recording.n_samples)
        assert np.abs(recording.read_v("drive") - asked).max() < 5e-3
        assert recording.steps["gamma"].tolist() == [0.4, 0.7, 0.9]


def test_seed_decides_the_noise(short: Path, tmp_path: Path) -> None:
    """The same seed gives the same recording, another seed another one; the last line is the next command."""
    codes = []
    for i, seed in enumerate((1, 1, 2)):
        result = bench("ramp", short, "--out", tmp_path / f"{i}.h5", "--seed", seed)
        assert result.exit_code == 0, result.output
        last = result.output.splitlines()[-1]
        assert last.startswith("next: bench close-loop") and f"{i}.h5" in last
        with open_recording(tmp_path / f"{i}.h5") as recording:
            codes.append(recording.codes("accelerometer"))
    assert np.array_equal(codes[0], codes[1]) and not np.array_equal(codes[0], codes[2])


def test_wrong_calls_leave_nothing(short: Path, tmp_path: Path) -> None:
    """A forbidden ramp, a bad free key, a missing folder and a missing scenario leave with 2 and no file."""
    wild = tmp_path / "wild.toml"
    wild.write_text(short.read_text(encoding="utf-8").replace("drive_v = 9.5", "drive_v = 0.5"), encoding="utf-8")
    out = tmp_path / "rec.h5"
    for arguments, said in (
        ((wild, "--out", out), "limits.drive_v allows 0.5"),
        ((short, "--out", out, "--set", "knob"), "wanted KEY=VALUE"),
        ((short, "--out", tmp_path / "nowhere" / "rec.h5"), "nowhere"),
        ((short, "--out", out, "--scenario", tmp_path / "none.toml"), "none.toml"),
    ):
        result = bench("ramp", *arguments)
        assert result.exit_code == 2 and said in result.stderr
    assert not list(tmp_path.glob("*.h5"))


def test_never_overwrites(short: Path, tmp_path: Path) -> None:
    """An existing file is refused and stays as it was."""
    out = tmp_path / "rec.h5"
    out.write_bytes(b"precious")
    assert bench("ramp", short, "--out", out).exit_code == 2
    assert out.read_bytes() == b"precious"


def test_a_replay_that_ends_fails_the_run_and_keeps_it(short: Path, tmp_path: Path) -> None:
    """The back end gives out mid-run: exit 1, recording marked failed, every sample kept."""
    source, out = tmp_path / "source.h5", tmp_path / "rec.h5"
    assert bench("ramp", short, "--out", source).exit_code == 0
    longer = tmp_path / "longer.toml"
    text = short.read_text(encoding="utf-8").replace("hold_cycles = 4", "hold_cycles = 6")
    longer.write_text(text.replace('kind = "simulated"', 'kind = "replay"'), encoding="utf-8")
    assert bench("ramp", longer, "--out", out).exit_code == 2  # no recording named
    result = bench("ramp", longer, "--out", out, "--replay", source)
    assert result.exit_code == 1 and "the recording ends after" in result.stderr
    with open_recording(source) as before, open_recording(out) as after:
        assert after.attrs["ended"] == "failed" and after.attrs["backend"] == "replay"
        n = after.n_samples
        assert before.n_samples - n < 250
        assert np.array_equal(before.codes("accelerometer", 0, n), after.codes("accelerometer"))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one child alone")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_valid_recording_at_zero(tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C in the middle of a paced run: exit 1, marked stopped with the signal's name, whole, the drive at zero."""
    out = tmp_path / "rec.h5"
    bench_command = [sys.executable, "-c", "from bench.cli import main; main()"]
    command = [*bench_command, "ramp", "simulated", "--real-time", "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        while not out.exists() or out.stat().st_size < 40_000:
            assert process.poll() is None, process.communicate()
            time.sleep(0.05)
        time.sleep(0.5)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 1 and b"stopped" in errors
    with open_recording(out) as recording:
        assert recording.attrs["ended"] == "stopped" and number.name in recording.attrs["why"]
        assert np.abs(recording.read_v("drive")[-200:]).max() < 5e-3
        fades = fades_of_changes(recording.setup, recording.drive_changes)
        asked = commanded(recording.setup, fades, 0, recording.n_samples)
        assert np.abs(recording.read_v("drive") - asked).max() < 5e-3
