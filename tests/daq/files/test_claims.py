"""What HDF5 says of a damaged file, in words for people."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.files.disk import in_words


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda data: data[: len(data) // 2], "shorter than it says"),
        (lambda data: b"x" * 100, "does not begin as one"),
        (lambda data: data[:600] + bytes(100) + data[700:], "tables or indexes are damaged"),
        (lambda data: data[:5000] + bytes(200) + data[5200:], "differ from what was written"),
    ],
)
def test_damage_is_said_in_plain_words(tmp_path: Path, damage, says: str) -> None:
    """Neither "Unable to synchronously open" nor the name of an inner structure reaches a reader."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", data=np.arange(100_000), chunks=(1000,), compression="gzip", fletcher32=True)
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises((OSError, KeyError, RuntimeError)) as raised, h5py.File(path, "r") as file:
        file["x"][:]
    assert says in in_words(raised.value)
    assert in_words(ValueError("wanted a table")) == "wanted a table"
