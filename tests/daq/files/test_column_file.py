"""The column file: what was compared when it was written is what is sealed."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.files.column_file import CHUNK_SAMPLES, ColumnWriter
from daq.files.tables import BLOCK_DTYPE, STEP_DTYPE
from daq.setup.setup import Setup


def writer_of(path: Path, setup: Setup, values: np.ndarray) -> ColumnWriter:
    """An open column file of one channel."""
    writer = ColumnWriter(path, setup, {"drive": values.dtype}, {"drive": (1.0, 0.0)}, {"setup_json": "{}"})
    writer.append(np.arange(len(values)), {"drive": values})
    writer.flush()
    return writer


@pytest.mark.parametrize("dtype", ["<i2", "<f8", "<f4", "u1"])
def test_every_type_is_read_back(tmp_path: Path, setup: Setup, dtype: str) -> None:
    """Codes and volts of every width, NaN and minus zero among them, pass the comparison bit by bit."""
    values = np.random.default_rng(1).integers(0, 200, 2 * CHUNK_SAMPLES + 77).astype(dtype)
    if values.dtype.kind == "f":
        values[:2] = np.nan, -0.0
    writer = writer_of(tmp_path / "a.h5", setup, values)
    writer.check(np.zeros(0, STEP_DTYPE), np.zeros(0, BLOCK_DTYPE))
    writer.rename()
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["drive"][()].tobytes() == values.tobytes()


def test_a_reader_of_the_growing_file_is_waited_for(
    tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows refuses to replace a file that somebody reads: the closed one takes its place once it is let go."""
    writer, tries, rename = writer_of(tmp_path / "a.h5", setup, np.zeros(9, np.int16)), [], Path.replace
    writer.check(np.zeros(0, STEP_DTYPE), np.zeros(0, BLOCK_DTYPE))

    def refused(path: Path, target: Path) -> Path:
        tries.append(path)
        if len(tries) < 3:
            raise PermissionError(13, "The process cannot access the file because it is being used by another process")
        return rename(path, target)

    monkeypatch.setattr(Path, "replace", refused)
    monkeypatch.setattr("daq.files.column_file.sys.platform", "win32")
    writer.rename()
    assert len(tries) == 3 and [path.name for path in tmp_path.iterdir()] == ["a.h5"]


@pytest.mark.parametrize("place", [0.3, 0.6, 0.95])
def test_a_byte_that_changes_before_the_seal_is_found(tmp_path: Path, setup: Setup, place: float) -> None:
    """A stored byte that differs from the one that was read back is an error, and the file is not renamed."""
    writer = writer_of(tmp_path / "a.h5", setup, np.random.default_rng(1).normal(size=3 * CHUNK_SAMPLES))
    with writer.part.open("r+b") as raw:
        at = int(place * writer.part.stat().st_size)
        raw.seek(at)
        byte = raw.read(1)
        raw.seek(at)
        raw.write(bytes([byte[0] ^ 1]))
    with pytest.raises(OSError, match="does not read back: drive: samples from"):
        writer.check(np.zeros(0, STEP_DTYPE), np.zeros(0, BLOCK_DTYPE))
    writer.abandon()
    assert list(tmp_path.iterdir()) == []
