"""NPZ files as tables, read piece by piece from the archive."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_OBJECTS, READ_ERRORS, ArraySource, split_index
from daq.importers.formats.columns import listed
from daq.setup.errors import InputError


class NpzSource(ArraySource):
    """Arrays of an NPZ file, read piece by piece from the archive."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._shapes: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}
        self._members: dict[str, str] = {}
        self._open: dict[str, tuple[Any, int]] = {}
        try:
            self._archive = zipfile.ZipFile(path)
            if len(self._archive.namelist()) > MOST_OBJECTS:
                raise InputError(f"{path}: holds more than {MOST_OBJECTS} arrays; keep only the columns.")
            for member in self._archive.namelist():
                with self._archive.open(member) as stream:
                    shape, order, dtype = _npy_header(stream)
                    name = member.removesuffix(".npy")
                    if shape in ((), (1,)) and dtype.kind in "iuf":
                        self._offer_rate(name, np.frombuffer(stream.read(dtype.itemsize), dtype)[0])
                if len(shape) == 2 and 1 not in shape and order:
                    continue  # column-major matrices cannot be read row by row
                self._shapes[name] = (shape, dtype)
                self._members[name] = member
                self._offer(name, shape, dtype)
        except READ_ERRORS as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: cannot be read as NPZ ({error}).") from error

    def _refuse_claims(self, name: str) -> None:
        stem = name if name in self._shapes else split_index(name)[0]
        shape, dtype = self._shapes[stem]
        member = self._archive.getinfo(self._members[stem])
        claimed = math.prod(shape) * dtype.itemsize
        if claimed > member.file_size:
            raise InputError(
                f"{self.path}: {listed([name])} claims {claimed} bytes of numbers, its part of the archive holds "
                f"{member.file_size}; it is damaged or cut off."
            )
        self._refuse_size(name, claimed, member.compress_size)

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        """Columns are read in order, so each keeps its place in the archive."""
        stem, column = (name, None) if name in self._shapes else split_index(name)
        shape, dtype = self._shapes[stem]
        width = shape[1] if column is not None else 1
        stream, at = self._open.get(name, (None, -1))
        if at != start:
            stream = self._archive.open(self._members[stem])
            _npy_header(stream)
            stream.seek(stream.tell() + start * width * dtype.itemsize)
        data = stream.read((stop - start) * width * dtype.itemsize)
        self._open[name] = (stream, stop)
        rows = np.frombuffer(data, dtype).reshape(-1, width)
        return rows[:, column or 0]


def _npy_header(stream: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = reader(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not read")
    return shape, fortran, dtype
