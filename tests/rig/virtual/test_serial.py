"""Audio out through PortAudio and JACK, frames in through a pseudo-terminal: the operator's commands, in real time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.recording import open_recording, verify
from rig.profile import Profile

BENCH = (sys.executable, "-c", "from bench.cli import main; main()")


SHORT = ("start = 0.4, stop = 2.6, steps = 23", "start = 0.8, stop = 1.2, steps = 2")


def ramp(text: str, folder: Path) -> list[str]:
    """`bench ramp` of a short ramp through card and serial device."""
    path = folder / "both.toml"
    path.write_text(text.replace(*SHORT), encoding="utf-8")
    return [*BENCH, "ramp", str(path), "--out", str(folder / "run.h5")]


@pytest.mark.slow
def test_a_rehearsal_in_real_time(virtual_both: tuple[Profile, str], tmp_path: Path) -> None:
    """A whole ramp through both drivers: complete, and on one time base to a ppm."""
    command = ramp(virtual_both[1], tmp_path)
    done = subprocess.run(command, env=dict(os.environ), text=True, capture_output=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert verify(tmp_path / "run.h5").state == "complete"
    with open_recording(tmp_path / "run.h5") as recording:
        rows, readings = recording.clock_map, recording.clock_readings
    assert len(rows) == 2 and len(readings) > 9
    assert np.all(np.abs(rows["rate"] - 80e-6) < 1e-6)


@pytest.mark.slow
def test_the_device_goes_away_in_mid_run(
    rehearse: Callable[..., Any], virtual_both: tuple[Profile, str], tmp_path: Path
) -> None:
    """The serial device ends in the middle of a run, the card plays on: it fails, names the port, keeps the data."""
    both = ('kind = "soundcard"', f'kind = "soundcard+serial"\nport = "{(tmp_path / "port").as_posix()}"')
    name = ('device = "shaker"', 'device = "unplugged"')
    with rehearse(both, name, server=os.environ["JACK_DEFAULT_SERVER"]) as (_, text, process):
        command = ramp(text, tmp_path)
        with subprocess.Popen(command, env=dict(os.environ), text=True, stderr=subprocess.PIPE) as run:
            while not (tmp_path / "run.h5").exists() or recorded(tmp_path / "run.h5") < 10_000:
                assert run.poll() is None
            process.terminate()
            _, said = run.communicate(timeout=60)
    assert run.returncode == 1
    assert "serial DAQ" in said
    report = verify(tmp_path / "run.h5")
    assert report.state == "stopped" and report.n_samples >= 10_000


def recorded(path: Path) -> int:
    """Samples of a recording that is being written, as far as it can be read."""
    try:
        with open_recording(path) as recording:
            return recording.n_samples
    except ValueError:
        return 0
