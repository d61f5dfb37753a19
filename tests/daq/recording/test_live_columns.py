"""Columns that grow while a run lasts: the same as those made from the frames, and never a risk to them."""

from __future__ import annotations

import errno
import os
import shutil
from collections import namedtuple
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401 (registers the filter)
import numpy as np
import pytest

from benchmarks.daq import kill
from daq.files.column_file import CHUNK_SAMPLES
from daq.files.disk import DiskFile
from daq.files.frames.frame_file import FrameFile
from daq.recording import CHANNELS, Block, open_recording, verify
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup

N, BLOCK = 2 * CHUNK_SAMPLES + 5000, 3000
CODES = np.random.default_rng(1).integers(-32768, 32767, (N, 3), np.int16)
Usage = namedtuple("Usage", "total used free")


def recorded(path: Path, setup: Setup) -> RecordingWriter:
    """An open run of two full chunks and a piece, with two gaps."""
    writer = RecordingWriter(path, setup, profile_text="p", channels=CHANNELS, backend="s", simulated=True)
    for first in range(0, N, BLOCK):
        lost = {30 * BLOCK: 7, 44 * BLOCK: 9}.get(first, 0)
        writer.append(Block(first, CODES[first : first + BLOCK], lost_before=lost))
    writer.mark_step({"first_sample": 0, "n_samples": N, "gamma": 0.5})
    return writer


def part_of(path: Path) -> Path:
    """The column file while it grows."""
    return path.with_name(path.name + ".part")


def same_as_given(path: Path) -> bool:
    """Whether a closed recording is sound and holds the codes, the gaps and the times that were given."""
    with open_recording(path) as recording:
        codes = [np.array_equal(recording.codes(name), CODES[:, i]) for i, name in enumerate(CHANNELS)]
        gaps = recording.gaps.tolist() == [[30 * BLOCK, 7], [44 * BLOCK, 9]]
        last = int(recording.timestamps_ns(N - 1, N)[0]) == (N - 1 + 16) * round(1e9 / recording.rate_hz)
    return verify(path).state == "complete" and all(codes) and gaps and last


def test_closing_does_not_read_the_frames_again(tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """The samples of a closed run are those that came, though closing reads none of the frames."""
    path = tmp_path / "a.h5"
    writer = recorded(path, setup)
    assert part_of(path).exists()
    with monkeypatch.context() as patch:
        patch.delattr(FrameFile, "rows")
        writer.close()
    assert same_as_given(path)
    assert list(tmp_path.iterdir()) == [path]


def test_they_are_those_made_from_the_frames(tmp_path: Path, setup: Setup) -> None:
    """Every stored chunk, every table and every attribute is equal to those of a run whose columns were dropped."""
    whole, dropped = tmp_path / "a.h5", tmp_path / "b.h5"
    recorded(whole, setup).close()
    writer = recorded(dropped, setup)
    writer._live.drop()
    assert not part_of(dropped).exists()
    writer.close()
    with h5py.File(whole) as one, h5py.File(dropped) as other:
        for name in ("timestamp", *CHANNELS):
            assert dict(one[name].attrs).keys() == dict(other[name].attrs).keys()
            assert one[name].attrs["crc32"] == other[name].attrs["crc32"]
            for start in range(0, N, CHUNK_SAMPLES):
                assert one[name].id.read_direct_chunk((start,)) == other[name].id.read_direct_chunk((start,))
        for table in ("steps", "blocks"):
            for key in one[table]:
                np.testing.assert_array_equal(one[table][key][()], other[table][key][()])
        differ = {k for k in other.attrs if not np.array_equal(one.attrs.get(k), other.attrs[k])}
        assert differ <= {"started", "ended_at", "attributes_crc32"}


def test_without_room_to_spare_they_are_dropped(tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the disk gets short the columns make room for the frames at once; the run goes on and closes whole."""
    path, plenty = tmp_path / "a.h5", Usage(1 << 40, 0, 1 << 40)
    left = iter([plenty, plenty, Usage(1 << 40, 0, 1000)])  # before the run, at the first chunk, at the second
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: next(left))
        writer = recorded(path, setup)
    assert not part_of(path).exists()
    writer.close()
    assert same_as_given(path)


@pytest.mark.parametrize("room", [0, 3000, 300_000])
def test_a_disk_that_refuses_them_costs_nothing(
    tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    """Wherever a refusal meets the columns, they are removed, and the frames give the whole run at the end."""
    plain = DiskFile.write

    def refuse(self: DiskFile, data: Any) -> int:
        if self._end > room:
            self.error = self.error or OSError(errno.ENOSPC, "No space left on device")
        return plain(self, data)

    path = tmp_path / "a.h5"
    with monkeypatch.context() as patch:
        patch.setattr(DiskFile, "write", refuse)
        writer = recorded(path, setup)
    assert not part_of(path).exists()
    writer.close()
    assert same_as_given(path)


def test_a_folder_that_takes_no_second_file_costs_nothing(
    tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the column file cannot be made during the run, it is made at the end."""

    def refuse(*arguments: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "a.h5"
    with monkeypatch.context() as patch:
        patch.setattr("daq.recording.writer.ColumnWriter", refuse)
        writer = recorded(path, setup)
    writer.close()
    assert same_as_given(path)


def test_columns_that_cannot_be_removed_cost_nothing(
    tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the folder does not let the dropped file go, the run goes on, and closing writes over it."""

    def refuse(*arguments: object, **options: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "a.h5"
    writer = recorded(path, setup)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", refuse)
        writer._live.drop()
    assert part_of(path).exists()
    writer.close()
    assert same_as_given(path)
    assert list(tmp_path.iterdir()) == [path]


def test_columns_damaged_during_the_run_are_made_again(tmp_path: Path, setup: Setup) -> None:
    """A byte of the growing columns that changes on the disk is found at the end: the frames are asked instead."""
    path = tmp_path / "a.h5"
    writer = recorded(path, setup)
    with part_of(path).open("r+b") as raw:
        raw.seek(200_000)
        byte = raw.read(1)
        raw.seek(200_000)
        raw.write(bytes([byte[0] ^ 4]))
    writer.close()
    assert same_as_given(path)


def test_other_frames_than_came_are_believed(tmp_path: Path, setup: Setup) -> None:
    """Where the frames file holds other samples than the columns (a row that was damaged), the frames count."""
    path = tmp_path / "a.h5"
    writer = recorded(path, setup)
    writer._live._gaps[0] = (30 * BLOCK, 8)
    writer.close()
    assert same_as_given(path)


def test_a_file_that_vanishes_takes_them_along(tmp_path: Path, setup: Setup) -> None:
    """A run whose file is removed is kept elsewhere, and no column file is left of it."""
    path = tmp_path / "a.h5"
    writer = recorded(path, setup)
    path.unlink()
    with pytest.raises(OSError, match="all of the run is in") as raised:
        writer.close("complete")
    kept = Path(str(raised.value).rsplit(" ", 1)[1])
    assert same_as_given(kept)
    assert list(tmp_path.iterdir()) == [kept]


@pytest.mark.skipif(os.name != "posix", reason="kills as POSIX knows them")
@pytest.mark.parametrize("seconds", [0.05, 0.1, 0.2])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_killed_while_they_grow(tmp_path: Path, seconds: float) -> None:
    """After SIGKILL amid several chunks, every acknowledged block is in the recovered file."""
    lost, whole, _ = kill.trial(tmp_path, seconds, 800)
    assert (lost, whole) == (0, True)


def test_recovering_beside_a_run_leaves_its_columns_alone(tmp_path: Path, setup: Setup) -> None:
    """A copy recovered while the run goes on does not touch the growing columns; the run closes whole."""
    path = tmp_path / "a.h5"
    writer = recorded(path, setup)
    assert recover(path).n_samples == N
    assert part_of(path).exists()
    writer.close()
    assert same_as_given(path)
