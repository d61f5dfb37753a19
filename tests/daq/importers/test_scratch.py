"""Scratch files of an import: read back as they came, gone afterwards."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.importers.intake import Scratch


def test_columns_come_back_and_nothing_stays(tmp_path: Path) -> None:
    """Any range of any column is what was added, in its type; afterwards the folder is as it was."""
    rng = np.random.default_rng(1)
    given = {"a": rng.normal(size=5000), "b": rng.integers(-9, 9, 5000).astype("<i2")}
    with Scratch(tmp_path, {name: values.dtype for name, values in given.items()}) as scratch:
        for start in range(0, 5000, 700):
            for name, values in given.items():
                scratch.append(name, values[start : start + 700])
                np.testing.assert_array_equal(scratch.read(name, 3, start), values[3:start])
        for name, values in given.items():
            assert scratch.read(name, 4000, 9999).dtype == values.dtype
            np.testing.assert_array_equal(scratch.read(name, 4000, 9999), values[4000:])
            assert len(scratch.read(name, 6000, 7000)) == 0
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    """A disk that refuses what is kept is named with its folder and what to do."""

    class Full:
        def write(self, data: Any) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        def close(self) -> None:
            """Nothing is open."""

    with Scratch(tmp_path, {"a": np.dtype("f8")}) as scratch:
        scratch._files["a"].close()
        scratch._files["a"] = Full()  # type: ignore[assignment]
        with pytest.raises(OSError, match=r"refuses to take more .No space left.*free some space") as raised:
            scratch.append("a", np.zeros(3))
    assert raised.value.filename == str(tmp_path)
