"""A full disk ends an import with a sentence: no crash of HDF5, nothing left under the final name."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from daq.files.column_file import ColumnWriter
from daq.files.disk import DiskFile
from daq.files.tables import BLOCK_DTYPE, STEP_DTYPE
from daq.setup.setup import Setup


class Full:
    """A file on a disk that takes ``room`` bytes and no more."""

    def __init__(self, file: Any, room: int) -> None:
        self._file, self._room = file, room

    def write(self, data: Any) -> int:
        """Write what still fits."""
        if self._room <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        done = int(self._file.write(data[: self._room]))
        self._room -= done
        return done

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def test_hdf5_through_it_is_hdf5(tmp_path: Path) -> None:
    """What is written through it reads back like any HDF5 file."""
    disk = DiskFile(tmp_path / "a.h5")
    with h5py.File(disk, "w") as file:
        file["x"] = np.arange(1000)
        assert file["x"][999] == 999
    disk.check()
    disk.close()
    with h5py.File(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(file["x"][()], np.arange(1000))


@pytest.mark.parametrize("room", [0, 100, 3000, 60_000, 300_000])
def test_a_full_disk_is_an_error_and_leaves_nothing(
    tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    """Wherever the disk fills, at the first byte or while closing, the writer raises and its file is removed."""
    plain = DiskFile.__init__

    def small(self: DiskFile, path: Path) -> None:
        plain(self, path)
        self._file = Full(self._file, room)  # type: ignore[assignment]

    monkeypatch.setattr(DiskFile, "__init__", small)
    noise = np.random.default_rng(1).normal(size=50_000)
    with pytest.raises(OSError, match=r"disk refuses to take more .No space left"):
        write(tmp_path / "a.h5", setup, noise)
    assert list(tmp_path.iterdir()) == []


def write(path: Path, setup: Setup, values: Any) -> None:
    """A recording of one channel."""
    writer = ColumnWriter(path, setup, {"drive": np.dtype("<f8")}, {"drive": (1.0, 0.0)}, {"setup_json": "{}"})
    try:
        writer.append(np.arange(len(values)), {"drive": values})
        writer.check(np.zeros(0, STEP_DTYPE), np.zeros(0, BLOCK_DTYPE))
        writer.rename()
    finally:
        writer.abandon()
