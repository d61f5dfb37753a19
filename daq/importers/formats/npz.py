"""NPZ files as tables, read piece by piece from the archive."""

from __future__ import annotations

import math
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_OBJECTS, ArraySource, refusals
from daq.importers.formats.columns import listed
from daq.setup.errors import InputError


class NpzSource(ArraySource):
    """Arrays of an NPZ file; each column keeps its place in the archive, because columns are read in order."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._places: dict[tuple[str, int | None], tuple[Any, int]] = {}  # by member and column: stream, next row
        with refusals(path, "cannot be read as NPZ"):
            self._archive = zipfile.ZipFile(self._handle())
            if len(self._archive.namelist()) > MOST_OBJECTS:
                raise InputError(f"{path}: holds more than {MOST_OBJECTS} arrays; keep only the columns.")
            for member in self._archive.namelist():
                name = member.removesuffix(".npy")
                with self._archive.open(member) as stream:
                    shape, by_columns, dtype = _npy_header(stream)
                    if shape in ((), (1,)) and dtype.kind in "iuf":
                        self._offer_rate(name, np.frombuffer(stream.read(dtype.itemsize), dtype)[0])
                if len(shape) == 2 and 1 not in shape and by_columns:
                    continue  # column-major matrices cannot be read row by row
                width = shape[1] if len(shape) == 2 and 1 not in shape else 1
                claimed = math.prod(shape) * dtype.itemsize
                read = partial(self._read, member, width, dtype)
                self._offer(name, shape, dtype, read, partial(self._stored, name, member, claimed))

    def _stored(self, name: str, member: str, claimed: int) -> int:
        """Bytes of the archive that hold an array; refuses one that is larger than its part unpacked."""
        part = self._archive.getinfo(member)
        if claimed > part.file_size:
            raise InputError(
                f"{self.path}: {listed([name])} claims {claimed} bytes of numbers, its part of the archive holds "
                f"{part.file_size}; it is damaged or cut off."
            )
        return part.compress_size

    def _read(
        self, member: str, width: int, dtype: np.dtype[Any], start: int, stop: int, column: int | None
    ) -> NDArray[Any]:
        stream, at = self._places.get((member, column), (None, -1))
        if at != start:
            stream = self._archive.open(member)
            _npy_header(stream)
            stream.seek(stream.tell() + start * width * dtype.itemsize)
        data = stream.read((stop - start) * width * dtype.itemsize)
        self._places[member, column] = stream, stop
        return np.frombuffer(data, dtype).reshape(-1, width)[:, column or 0]


def _npy_header(stream: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether by columns, and type; raises ValueError for Python objects."""
    version = np.lib.format.read_magic(stream)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, by_columns, dtype = reader(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not read")
    return shape, by_columns, dtype
