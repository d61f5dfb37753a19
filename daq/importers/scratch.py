"""Scratch files of an import: numbers that are read again and again while it lasts.

A file without a name in the recording's folder holds them: memory does not depend on their number, and nothing is left
of it, however the import ends. Reading a column here costs a tenth of unpacking it from the recording.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.disk import Closing, refusal


class Scratch(Closing):
    """Columns in raw files in ``folder``, by name of the types ``dtypes``; each grows at its end."""

    def __init__(self, folder: Path, dtypes: Mapping[str, np.dtype[Any]]) -> None:
        self._folder = folder
        self._dtypes = {name: np.dtype(dtype) for name, dtype in dtypes.items()}
        self._files = {name: tempfile.TemporaryFile(dir=folder, buffering=0) for name in dtypes}  # noqa: SIM115

    def append(self, name: str, values: NDArray[Any]) -> None:
        """Add values to the end of a column; raises OSError naming the folder, when the disk refuses."""
        left = np.ascontiguousarray(values, self._dtypes[name]).data.cast("B")
        try:
            while len(left):
                left = left[self._files[name].write(left) :]
        except OSError as error:
            raise refusal(error, self._folder) from error

    def read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        """Values ``start`` to ``stop`` of a column, fewer where it ends."""
        dtype, file = self._dtypes[name], self._files[name]
        n = max(min(stop, file.seek(0, 2) // dtype.itemsize) - start, 0)
        values = np.empty(n, dtype)
        left = values.data.cast("B")
        file.seek(start * dtype.itemsize)
        while len(left):
            left = left[file.readinto(left) :]
        file.seek(0, 2)  # where `append` goes on
        return values

    def close(self) -> None:
        """Remove everything."""
        for file in self._files.values():
            file.close()
