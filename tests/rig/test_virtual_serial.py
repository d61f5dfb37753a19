"""Audio out through PortAudio and JACK, frames in through a pseudo-terminal: the operator's commands, in real time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.recording import open_recording, verify

BENCH = (sys.executable, "-c", "from bench.cli import main; main()")


@pytest.fixture
def rehearsal(rehearse: Callable[..., Any], tmp_path: Path) -> Iterator[tuple[list[str], subprocess.Popen[str]]]:
    """A short `bench ramp` through card and serial device, and the process with the plant behind both."""
    both = ('kind = "soundcard"', f'kind = "soundcard+serial"\nport = "{(tmp_path / "port").as_posix()}"')
    short = ("start = 0.4, stop = 2.6, steps = 23", "start = 0.8, stop = 1.2, steps = 2")
    with rehearse(both, short) as (_, text, process):
        path = tmp_path / "both.toml"
        path.write_text(text, encoding="utf-8")
        yield [*BENCH, "ramp", str(path), "--out", str(tmp_path / "run.h5")], process


def test_a_rehearsal_in_real_time(rehearsal: tuple[list[str], subprocess.Popen[str]], tmp_path: Path) -> None:
    """A whole ramp through both drivers: complete, and on one time base to a ppm."""
    done = subprocess.run(
        rehearsal[0], env=dict(os.environ), text=True, capture_output=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert verify(tmp_path / "run.h5").state == "complete"
    with open_recording(tmp_path / "run.h5") as recording:
        rows, readings = recording.clock_map, recording.clock_readings
    assert len(rows) == 2 and len(readings) > 20
    assert np.all(np.abs(rows["rate"] - 80e-6) < 1e-6)


def test_the_plant_goes_away_in_mid_run(rehearsal: tuple[list[str], subprocess.Popen[str]], tmp_path: Path) -> None:
    """Device and card end in the middle of a run: it fails, names what went, keeps the data."""
    command, process = rehearsal
    with subprocess.Popen(command, env=dict(os.environ), text=True, stderr=subprocess.PIPE) as run:
        while not (tmp_path / "run.h5").exists() or recorded(tmp_path / "run.h5") < 20_000:
            assert run.poll() is None
        process.terminate()
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
