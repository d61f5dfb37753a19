"""Recordings that were cut off: nothing acknowledged is lost, by a kill, a full disk, or a file that is gone."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from benchmarks.daq import kill
from daq.files.frames.frame_file import is_being_written, lookup3
from daq.recording import CHANNELS, Block, open_recording, verify
from daq.recording.header import refuse_repeated
from daq.recording.reader import Recording
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup

CODES = np.random.default_rng(1).integers(-999, 999, (3000, 3), np.int16)
posix = pytest.mark.skipif(os.name != "posix", reason="kills and limits as POSIX knows them")


def writer_of(path: Path, setup: Setup, **options: int) -> RecordingWriter:
    """A writer with three blocks and a step in it."""
    writer = RecordingWriter(
        path, setup, profile_text="p", channels=CHANNELS, backend="s", simulated=True, note="n", **options
    )
    for first in range(0, 3000, 1000):
        writer.append(Block(first, CODES[first : first + 1000], clock_ns=first))
    writer.mark_step({"first_sample": 0, "n_samples": 9999, "gamma": 0.5})
    return writer


def test_an_unclosed_run_is_recovered(tmp_path: Path, setup: Setup) -> None:
    """What was flushed is rebuilt, verified and marked; the step that was under way ends where the frames do."""
    writer = writer_of(tmp_path / "a.h5", setup)
    found = recover(tmp_path / "a.h5")
    assert (found.path.name, found.n_samples, found.n_steps) == ("a.recovered.h5", 3000, 1)
    report = verify(found.path)
    assert report.state == "stopped"
    assert "cut off after 3000 samples" in report.where[0]
    with open_recording(found.path) as recording:
        assert recording.attrs["recovered"] is True
        assert recording.attrs["note"] == "n"
        assert recording.steps["n_samples"].tolist() == [3000]
        np.testing.assert_array_equal(recording.codes("drive"), CODES[:, 2])
    writer.close()
    with pytest.raises(InputError, match="nothing to recover"):
        recover(tmp_path / "a.h5", tmp_path / "b.h5")
    with pytest.raises(InputError, match="never overwritten"):
        writer_of(tmp_path / "c.h5", setup)
        recover(tmp_path / "c.h5", found.path)


def test_samples_are_compared_only_where_two_runs_have_as_many(
    tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs that were cut off are read for the comparison only next to one of as many samples, and no closed one is."""
    read: list[str] = []
    codes = Recording.codes

    def noted(recording: Recording, *asked: Any, **more: Any) -> Any:
        read.append(recording.path.name)
        return codes(recording, *asked, **more)

    paths = [tmp_path / name for name in ("cut.h5", "longer.h5", "closed.h5", "copy.h5")]
    cut, longer, closed = (writer_of(path, setup) for path in paths[:3])
    longer.append(Block(3000, CODES[:10], clock_ns=3000))
    closed.append(Block(3000, CODES[:20], clock_ns=3000))
    closed.close()
    paths[3].write_bytes(paths[2].read_bytes())
    monkeypatch.setattr(Recording, "codes", noted)
    refuse_repeated(paths[:3])
    with pytest.raises(InputError, match=r"closed\.h5 and .*copy\.h5 hold the same samples"):
        refuse_repeated(paths)
    assert not read
    twin = writer_of(tmp_path / "twin.h5", setup)
    with pytest.raises(InputError, match=r"cut\.h5 and .*twin\.h5 hold the same samples"):
        refuse_repeated([*paths[:3], twin.path])
    assert set(read) == {"cut.h5", "twin.h5"}
    cut.close()
    with pytest.raises(InputError, match=r"cut\.h5 and .*twin\.h5 hold the same samples"):
        refuse_repeated([cut.path, twin.path])


def test_frames_without_their_row_do_not_count(tmp_path: Path, setup: Setup) -> None:
    """A kill between the frames and the row that acknowledges them costs that block only."""
    writer = writer_of(tmp_path / "a.h5", setup)
    writer._frames._frames.resize((3500, 3))
    writer._frames._frames.id.flush()
    assert recover(tmp_path / "a.h5").n_samples == 3000


@posix
@pytest.mark.parametrize("seconds", [0.0, 0.02, 0.1])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_killed_recorders(tmp_path: Path, seconds: float) -> None:
    """After SIGKILL at some moment, every acknowledged block is in the recovered file (200 of these: benchmarks)."""
    lost, whole, _ = kill.trial(tmp_path, seconds, 200)
    assert (lost, whole) == (0, True)


@posix
@pytest.mark.parametrize("limit", [120_000, 200_000, 400_000])
def test_a_full_disk(tmp_path: Path, limit: int) -> None:
    """Where the disk refuses, the writer says so, the process ends in peace, and every acknowledged block is there."""
    script = """
        import resource, signal, sys
        from pathlib import Path
        import numpy as np
        from daq.recording import CHANNELS, Block
        from daq.recording.writer import RecordingWriter
        from daq.setup.setup import Setup
        limit, path = int(sys.argv[1]), Path(sys.argv[2])
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        setup = {"name": "t", "forcing": {"frequency_hz": 25.0}, "ball": {"mass_kg": 1.0},
                 "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}}}
        writer = RecordingWriter(path, Setup.model_validate(setup), profile_text="", channels=CHANNELS,
                                 backend="s", simulated=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        safe = 0
        try:
            for i in range(1000):
                writer.append(Block(1000 * i, np.full((1000, 3), i, np.int16)))
                safe += 1000
        except OSError as error:
            print("refused:", error)
        try:
            writer.close("failed", "disk full")
        except OSError as error:
            print("kept:", error)
        print("safe", safe)
    """
    path = tmp_path / "a.h5"
    command = [sys.executable, "-c", textwrap.dedent(script), str(limit), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "refused:" in done.stdout, done.stderr
    assert "kept:" in done.stdout
    assert "bench recover" in done.stdout
    safe = int(done.stdout.split()[-1])
    assert is_being_written(path)  # nothing touched the file after the refusal
    found = recover(path)
    assert found.n_samples >= safe > 0
    with open_recording(found.path) as recording:
        np.testing.assert_array_equal(recording.codes("drive"), np.repeat(np.arange(found.n_samples // 1000), 1000))


def test_a_file_that_claims_more_than_it_holds(tmp_path: Path, setup: Setup) -> None:
    """Frames that HDF5 marked as closed although their end was refused: all blocks that are there are recovered."""
    path = tmp_path / "a.h5"
    writer_of(path, setup)
    head = bytearray(path.read_bytes()[:48])
    head[11] &= ~5
    head[28:36] = (path.stat().st_size + 43_596).to_bytes(8, "little")
    head[44:] = lookup3(bytes(head[:44])).to_bytes(4, "little")
    copy = tmp_path / "b.h5"
    copy.write_bytes(bytes(head) + path.read_bytes()[48:])
    with pytest.raises(OSError, match="truncated file"):
        h5py.File(copy)
    found = recover(copy)
    assert found.n_samples == 3000 and "shorter than it says" in " ".join(found.damage)


@posix
@pytest.mark.parametrize("folder_too", [False, True])
def test_a_file_that_vanishes(tmp_path: Path, setup: Setup, folder_too: bool) -> None:
    """A file (and its folder) removed during the run: the next block says so, and closing keeps all of it elsewhere."""
    folder = tmp_path / "run"
    folder.mkdir()
    writer = writer_of(folder / "a.h5", setup)
    (folder / "a.h5").unlink()
    if folder_too:
        folder.rmdir()
    with pytest.raises(OSError, match="was removed while"):
        writer.append(Block(3000, CODES))
    with pytest.raises(OSError, match="all of the run is in") as raised:
        writer.close("failed", "removed")
    kept = Path(str(raised.value).rsplit(" ", 1)[1])
    try:
        assert verify(kept).state == "stopped"
        with open_recording(kept) as recording:
            np.testing.assert_array_equal(recording.codes("drive"), CODES[:, 2])
    finally:
        kept.unlink()


def test_permission_lost_before_the_end(tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the folder no longer takes a new file, the frames stay, and recovering elsewhere gives the whole run."""

    def refuse(*arguments: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied")

    writer = writer_of(tmp_path / "a.h5", setup)
    with monkeypatch.context() as patch, pytest.raises(OSError, match=r"frames are safe.*Permission denied.*recover"):
        patch.setattr("daq.recording.writer.ColumnWriter", refuse)
        writer.close("complete")
    found = recover(tmp_path / "a.h5", tmp_path / "b.h5")
    assert verify(found.path).state == "complete"  # the run itself had ended as planned


def test_room_is_checked_before_the_start(tmp_path: Path, setup: Setup) -> None:
    """A run that cannot fit is refused before anything moves, with what it needs and what there is."""
    with pytest.raises(InputError, match=r"needs up to .* MB .* MB free"):
        writer_of(tmp_path / "a.h5", setup, expected_samples=10**15)
    assert not (tmp_path / "a.h5").exists()
    writer_of(tmp_path / "a.h5", setup, expected_samples=3000).close()


def test_nothing_recorded_cannot_be_recovered(tmp_path: Path, setup: Setup) -> None:
    """A run that was cut off before its first block says so."""
    RecordingWriter(tmp_path / "a.h5", setup, profile_text="", channels=CHANNELS, backend="s", simulated=True)
    with pytest.raises(InputError, match="no block had been recorded"):
        recover(tmp_path / "a.h5")
