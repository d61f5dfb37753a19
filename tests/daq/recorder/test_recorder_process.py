"""The recorder process: a ring that neither tears nor drops in silence, and a recording like any other."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from daq.files.tables import STEP_DTYPE, Block
from daq.recorder.recorder_process import RecorderProcess
from daq.recorder.shared_ring import FOLDER, NAME, Ring, clear_left_behind
from daq.recording import CHANNELS, open_recording, verify
from daq.recording.writer import RecordingWriter
from daq.setup.clock import Clock
from daq.setup.errors import InputError
from daq.setup.setup import Setup

OPTIONS = {"profile_text": "", "channels": CHANNELS, "backend": "s", "simulated": True}
CODES = np.random.default_rng(3).integers(-999, 999, (50_000, 3), np.int16)


def test_the_ring_keeps_order_and_counts_what_it_cannot_hold() -> None:
    """Blocks come out as they went in; what found the ring full is declared by the next block that fits."""
    ring = Ring(4, 100, 3)
    reader = Ring(4, 100, 3, ring.name)
    try:
        for i in range(6):
            assert ring.put(Block(i * 50, CODES[i * 50 : i * 50 + 50], flags=i)) is (i < 4)
        out = reader.take()
        assert [b.flags for b in out] == [0, 1, 2, 3]
        np.testing.assert_array_equal(np.concatenate([b.codes for b in out]), CODES[:200])
        ring.put(Block(300, CODES[300:350]))
        assert [b.lost_before for b in reader.take()] == [100]
        assert (ring.counter("dropped_blocks"), ring.counter("worst_backlog"), reader.take()) == (2, 4, [])
        with pytest.raises(ValueError, match="at most 100 frames"):
            ring.put(Block(0, CODES[:101]))
    finally:
        reader.close()
        ring.close()


def test_records_like_the_writer(tmp_path: Path, setup: Setup) -> None:
    """Blocks, steps, the end and the balance are those of a recording written in this process."""
    with RecorderProcess(tmp_path / "a.h5", setup, **OPTIONS) as recorder:
        for first in range(0, 50_000, 1000):
            recorder.append(Block(first, CODES[first : first + 1000], clock_ns=first))
        recorder.mark_step({"first_sample": 0, "n_samples": 25_000, "gamma": 0.5})
        row = np.zeros(1, STEP_DTYPE)[0]
        row["first_sample"], row["n_samples"] = 25_000, 25_000
        recorder.mark_step(row)
        recorder.close("stopped", "enough", expected_samples=50_000)
    report = verify(tmp_path / "a.h5")
    assert (report.state, report.suspect) == ("stopped", False)
    with open_recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording.codes("drive"), CODES[:, 2])
        assert recording.blocks["clock_ns"].tolist() == list(range(0, 50_000, 1000))
        assert recording.steps["first_sample"].tolist() == [0, 25_000]
        assert recording.attrs["why"] == "enough"


def test_bad_input_is_refused_at_the_start(tmp_path: Path, setup: Setup) -> None:
    """What the writer refuses, the process refuses with the same words."""
    (tmp_path / "a.h5").write_text("taken")
    with pytest.raises(InputError, match="never overwritten"):
        RecorderProcess(tmp_path / "a.h5", setup, **OPTIONS)


def test_a_vanished_file_is_reported_and_kept(tmp_path: Path, setup: Setup) -> None:
    """An error of the recorder reaches the run at a later block, and the message says where the frames are."""
    recorder = RecorderProcess(tmp_path / "a.h5", setup, **OPTIONS)
    recorder.append(Block(0, CODES[:1000]))
    while recorder.safe_samples < 1000:
        time.sleep(0.01)
    (tmp_path / "a.h5").unlink()
    with pytest.raises(OSError, match="was removed") as raised:
        for i in range(1, 2000):
            recorder.append(Block(1000 * i, CODES[:1000]))
            time.sleep(0.005)
    kept = next(tmp_path.glob("a.rescued*"))
    assert str(kept) in str(raised.value)
    assert verify(kept).n_samples >= 1000
    with pytest.raises(OSError, match="was removed"):
        recorder.close()


def test_the_operator_dies_the_recording_lives(tmp_path: Path) -> None:
    """When the process that feeds it is killed, the recorder writes what it has and closes the file."""
    script = """
        import sys, os, signal, time
        import numpy as np
        from daq.files.tables import Block
        from daq.recorder.recorder_process import RecorderProcess
        from daq.recording import CHANNELS
        from daq.setup.setup import Setup
        if __name__ == "__main__":
            setup = Setup.model_validate({"name": "t", "forcing": {"frequency_hz": 25.0}, "ball": {"mass_kg": 1.0},
                "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}}})
            recorder = RecorderProcess(sys.argv[1], setup, profile_text="", channels=CHANNELS, backend="s",
                                       simulated=True)
            for i in range(20):
                recorder.append(Block(1000 * i, np.full((1000, 3), i, np.int16)))
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10)
    """
    (tmp_path / "feed.py").write_text(textwrap.dedent(script))
    path = tmp_path / "a.h5"
    done = subprocess.run([sys.executable, str(tmp_path / "feed.py"), str(path)], capture_output=True, timeout=60)
    assert done.returncode in (-signal.SIGTERM, 1, 15)
    for _ in range(200):
        if path.is_file() and verify(path).state != "incomplete":
            break
        time.sleep(0.1)
    report = verify(path)
    assert (report.state, report.n_samples) == ("stopped", 20_000)
    assert "is gone" in report.where[0]


def test_a_ring_without_room_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Full shared memory is an error with words at the start, not a bus error in the middle of a run."""
    if not FOLDER.is_dir():
        pytest.skip("shared memory has no folder here")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    own = f"{NAME}-{os.getpid()}-*"  # other programs' segments come and go meanwhile
    before = set(FOLDER.glob(own))
    with pytest.raises(OSError, match=r"no room for the 0\.0 MB between run and recorder"):
        Ring(4, 100, 3)
    assert set(FOLDER.glob(own)) <= before


def test_leftovers_of_the_dead_are_cleared(tmp_path: Path) -> None:
    """Segments of processes that are no more go, those of the living, the young and of others stay."""
    if not sys.platform.startswith("linux"):
        pytest.skip("segments are files on Linux alone")
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    names = [f"{NAME}-{done.pid}-aa", f"{NAME}-{os.getpid()}-bb", f"{NAME}-{done.pid}-cc", f"other-{done.pid}-dd"]
    for name in names:
        (tmp_path / name).write_bytes(b"")
    for name in (names[0], names[1], names[3]):
        os.utime(tmp_path / name, (1.0, 1.0))
    assert clear_left_behind(tmp_path) == [names[0]]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])


def test_a_recorder_that_never_writes_ends_the_run(tmp_path: Path, setup: Setup) -> None:
    """A ring that is full stops the run with words; what it holds is written once the recorder goes on."""
    if not hasattr(signal, "SIGSTOP"):
        pytest.skip("processes are stopped by signal on POSIX alone")
    recorder = RecorderProcess(tmp_path / "a.h5", setup, ring_s=0.5, patience_s=0.0, **OPTIONS)
    pid = recorder._process.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    try:
        with pytest.raises(OSError, match=r"has not written for [01] s"):
            for i in range(200):
                recorder.append(Block(1000 * i, CODES[:1000]))
    finally:
        os.kill(pid, signal.SIGCONT)
    n = recorder.n_samples
    recorder.close("failed", "the recorder stood still", expected_samples=n)
    report = verify(tmp_path / "a.h5")
    assert (report.state, report.n_samples) == ("stopped", n) and n >= 4000


class SteppedClock(Clock):
    """A machine whose wall clock is set while a run lasts."""

    now_ns = 1_800_000_000 * 10**9

    def unix_ns(self) -> int:
        return self.now_ns


def test_a_stepped_clock_moves_no_sample(tmp_path: Path, setup: Setup) -> None:
    """The system's clock set back by years in the middle of a run: samples and their times stay what they were."""
    clock = SteppedClock()
    writer = RecordingWriter(tmp_path / "a.h5", setup, clock=clock, **OPTIONS)
    writer.append(Block(0, CODES[:1000], clock_ns=10**9))
    clock.now_ns = 10**18
    writer.append(Block(1000, CODES[1000:2000], clock_ns=2 * 10**9))
    writer.close("complete", expected_samples=2000)
    report = verify(tmp_path / "a.h5")
    assert (report.state, report.suspect, report.n_samples) == ("complete", False, 2000)
    with open_recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording.codes("drive"), CODES[:2000, 2])
