"""Tables that only some runs have: what was read of a second clock, and the map fitted to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daq.files.tables import CLOCK_DTYPE, MAP_DTYPE, Block
from daq.recorder.recorder_process import RecorderProcess
from daq.recording import CHANNELS, open_recording, verify
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup

OPTIONS = {"profile_text": "p", "channels": CHANNELS, "backend": "s", "simulated": True}
READINGS = np.array([(10**10 + k, k, k - 311.25, 0.01, k == 200) for k in (100, 200, 300)], CLOCK_DTYPE)
MAP = np.array([(200, -111.25, 1e-3, 8e-5, 1e-7)], MAP_DTYPE)


def fill(writer: RecordingWriter | RecorderProcess) -> None:
    """Frames, then the tables in two pieces."""
    writer.append(Block(0, np.ones((400, 3), np.int16)))
    writer.mark_rows("clock_readings", READINGS[:2])
    writer.mark_rows("clock_map", MAP)
    writer.mark_rows("clock_readings", READINGS[2:])


def same(path: Path) -> None:
    """The tables read back to the last bit."""
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording.clock_readings, READINGS)
        np.testing.assert_array_equal(recording.clock_map, MAP)


def test_they_survive_closing_and_are_checked(tmp_path: Path, setup: Setup) -> None:
    """While the run lasts, and in the column file: the same rows; a run without them has empty tables."""
    writer = RecordingWriter(tmp_path / "a.h5", setup, **OPTIONS)
    fill(writer)
    same(tmp_path / "a.h5")
    writer.close()
    assert verify(tmp_path / "a.h5").state == "complete"
    same(tmp_path / "a.h5")
    with RecordingWriter(tmp_path / "b.h5", setup, **OPTIONS) as plain:
        plain.append(Block(0, np.ones((4, 3), np.int16)))
    with open_recording(tmp_path / "b.h5") as recording:
        assert len(recording.clock_readings) == len(recording.clock_map) == len(recording.drive_changes) == 0


def test_they_are_recovered_from_a_run_that_was_cut_off(tmp_path: Path, setup: Setup) -> None:
    """What was written down of the clocks before the end is in the recovered file."""
    writer = RecordingWriter(tmp_path / "a.h5", setup, **OPTIONS)
    fill(writer)
    same(recover(tmp_path / "a.h5").path)
    writer.close()


def test_they_pass_through_the_recorder_process(tmp_path: Path, setup: Setup) -> None:
    """The recorder in a process of its own keeps them too, and a block larger than a slot of its ring."""
    with RecorderProcess(tmp_path / "a.h5", setup, block_samples=64, **OPTIONS) as writer:
        fill(writer)
    same(tmp_path / "a.h5")
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.n_samples == 400
        assert recording.blocks["n_samples"].tolist() == [64] * 6 + [16]
