"""Audio out through PortAudio and JACK, frames in through a pseudo-terminal: the operator's commands, in real time."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bench.profiles import load
from daq.recording import open_recording, verify
from rig.virtual.jack import jack_server

BENCH = (sys.executable, "-c", "from bench.cli import main; main()")
SERVER = f"test-serial-{os.getpid()}"
ENVIRONMENT = os.environ | {"JACK_DEFAULT_SERVER": SERVER}


@pytest.fixture
def rehearsal(tmp_path: Path) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """A profile of card and serial device, and `bench virtual` with the plant behind both."""
    pytest.importorskip("jack", reason="JACK-Client or libjack is not installed", exc_type=(ImportError, OSError))
    if shutil.which("jackd") is None or not hasattr(os, "openpty"):
        pytest.skip("no jackd, or no pseudo-terminals")
    _, text = load("simulated")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 0.8, stop = 1.2, steps = 2")
    port = tmp_path / "port"
    text = text.replace('kind = "simulated"', f'kind = "soundcard+serial"\ndevice = "shaker"\nport = "{port}"')
    path = tmp_path / "both.toml"
    path.write_text(text, encoding="utf-8")
    command = [*BENCH, "virtual", str(path), "--server", SERVER, "--ppm", "80"]
    with (
        jack_server(SERVER, 20000.0, 256),  # outlives the plant, which a test kills
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdout is not None
        assert "ready" in process.stdout.readline()
        yield path, process
        process.terminate()


def test_a_rehearsal_in_real_time(rehearsal: tuple[Path, subprocess.Popen[str]], tmp_path: Path) -> None:
    """A whole ramp through both drivers: complete, and on one time base to a ppm."""
    command = [*BENCH, "ramp", str(rehearsal[0]), "--out", str(tmp_path / "run.h5")]
    done = subprocess.run(command, env=ENVIRONMENT, text=True, capture_output=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert verify(tmp_path / "run.h5").state == "complete"
    with open_recording(tmp_path / "run.h5") as recording:
        rows, readings = recording.clock_map, recording.clock_readings
    assert len(rows) == 2 and len(readings) > 20
    assert np.all(np.abs(rows["rate"] - 80e-6) < 1e-6)


def test_the_plant_dies_in_mid_run(rehearsal: tuple[Path, subprocess.Popen[str]], tmp_path: Path) -> None:
    """The process with the device is killed as the run begins to record: it fails, names what went, keeps the data."""
    profile, process = rehearsal
    command = [*BENCH, "ramp", str(profile), "--out", str(tmp_path / "run.h5")]
    with subprocess.Popen(command, env=ENVIRONMENT, text=True, stderr=subprocess.PIPE) as run:
        while not (tmp_path / "run.h5").exists() or recorded(tmp_path / "run.h5") < 20_000:
            assert run.poll() is None
        process.kill()
        _, said = run.communicate(timeout=60)
    assert run.returncode == 1
    assert "serial DAQ" in said or "sound card" in said
    report = verify(tmp_path / "run.h5")
    assert report.state == "stopped" and report.n_samples >= 20_000


def recorded(path: Path) -> int:
    """Samples of a recording that is being written, as far as it can be read."""
    try:
        with open_recording(path) as recording:
            return recording.n_samples
    except ValueError:
        return 0
