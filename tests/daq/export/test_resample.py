"""A view at another rate: the same signal, in place, however it is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.profiles.find import load
from daq.export.export import export
from daq.export.resample import Resampled
from daq.files.tables import Block
from daq.recording import Recording, open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError

SCALE = 10.0 / 32768.0


def tone(t_s: np.ndarray) -> np.ndarray:
    """What was recorded: a forcing tone and something faster."""
    return 3.0 * np.sin(2 * np.pi * 25.37 * t_s) + 0.5 * np.cos(2 * np.pi * 1700.0 * t_s)


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    """Two seconds at 48 kHz."""
    profile, text = load("soundcard")
    codes = np.rint(tone(np.arange(96_000) / 48_000)[:, np.newaxis] / SCALE).astype(np.int16).repeat(3, axis=1)
    channels = ("continuity", "accelerometer", "drive")
    with RecordingWriter(
        tmp_path / "rec.h5", profile.setup(), profile_text=text, channels=channels, backend="soundcard",
        simulated=False, scales=dict.fromkeys(channels, (SCALE, 0.0)),
    ) as writer:  # fmt: skip
        for k in range(0, 96_000, 1000):
            writer.append(Block(k, codes[k : k + 1000]))
        writer.mark_step({"first_sample": 4800, "n_samples": 48_000, "gamma": 1.0})
    return open_recording(tmp_path / "rec.h5")


@pytest.mark.parametrize("rate_hz", [20000.0, 44100.0])
def test_the_signal_is_the_same_in_time(recording: Recording, rate_hz: float) -> None:
    """A tone comes out undelayed and unscaled, to a code's rounding, at a lower rate and at an awkward one."""
    view = Resampled(recording, rate_hz)
    assert view.n_samples == 2 * rate_hz and view.rate_hz == rate_hz
    inside = slice(1000, view.n_samples - 1000)
    off = view.read_v("drive", 0, view.n_samples)[inside] - tone(np.arange(view.n_samples)[inside] / rate_hz)
    assert np.abs(off).max() < 3 * SCALE
    assert np.allclose(view.timestamps_ns(0, 50), np.arange(50) * 1e9 / rate_hz, atol=1.0)


def test_pieces_are_the_whole(recording: Recording) -> None:
    """Read piece by piece or at once: the same to a thousandth of a code."""
    view = Resampled(recording, 20000.0)
    whole = view.read_v("drive", 0, view.n_samples)
    pieces = [view.read_v("drive", a, min(a + 7777, view.n_samples)) for a in range(0, view.n_samples, 7777)]
    assert np.abs(np.concatenate(pieces) - whole).max() < 1e-3 * SCALE


def test_steps_and_files_follow(recording: Recording, tmp_path: Path) -> None:
    """The step table counts in the new rate, and an NPZ has it; HDF5 and rates without a ratio are refused."""
    view = Resampled(recording, 20000.0)
    assert view.steps["first_sample"][0] == 2000 and view.steps["n_samples"][0] == 20_000
    export(view, tmp_path / "out.npz", "npz")
    with np.load(tmp_path / "out.npz") as file:
        assert file["rate_hz"] == 20000.0 and len(file["drive_v"]) == len(file["time_s"]) == 40_000
    with pytest.raises(InputError, match="as it is"):
        export(view, tmp_path / "out.h5", "h5")
    with pytest.raises(InputError, match="cannot be brought"):
        Resampled(recording, 19999.98765)
