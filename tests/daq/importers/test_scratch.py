"""What an import keeps while it lasts: read back as it came, gone afterwards; and what it does in threads."""

from __future__ import annotations

import errno
import hashlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.importers.background import Digest, ahead
from daq.importers.scratch import Scratch


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


def test_reading_ahead_keeps_order_and_errors() -> None:
    """Items come in order, an error after those before it, and one that stops early leaves no thread."""

    def items() -> Iterator[int]:
        yield from range(5)
        raise ValueError("the sixth")

    seen = []
    with pytest.raises(ValueError, match="the sixth"):
        for item in ahead(items()):
            seen.append(item)
    assert seen == [0, 1, 2, 3, 4]
    early = ahead(items())
    assert next(early) == 0
    early.close()  # type: ignore[attr-defined]
    assert not [t for t in threading.enumerate() if t.name.startswith("reading ahead")]


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    """The hash made in a thread is the file's; a file that is gone is an error where it is asked for."""
    raw = tmp_path / "a.csv"
    raw.write_bytes(bytes(range(256)) * 9000)
    with Digest(raw) as digest:
        assert digest.result() == hashlib.sha256(raw.read_bytes()).hexdigest()
    with Digest(tmp_path / "none") as digest, pytest.raises(FileNotFoundError):
        digest.result()
