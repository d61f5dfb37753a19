"""Base classes of the binary importers: arrays of a file as a table of columns of equal length.

Numbers keep the type they have in the file. A file's own scale (`scale_factor`, a WAV's full scale) is stored with
them and never applied to them.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.columns import PIECE_ROWS, RATE_NAMES, Piece, listed, split_name
from daq.setup.errors import InputError

_MOST_COLUMNS = 64  # widest matrix that is read as columns
MOST_OBJECTS = 10_000  # most datasets and groups of one file
MOST_PACKED = 2000  # largest credible compression factor of a measurement
SMALL_BYTES = 1 << 24  # content below this size is read whatever its compression
_KINDS = {"c": "complex numbers", "S": "text", "U": "text", "O": "text or lists", "M": "dates", "m": "durations"}
READ_ERRORS = (
    OSError, ValueError, EOFError, RuntimeError, NotImplementedError, KeyError, TypeError, zlib.error,
    zipfile.BadZipFile,
)  # fmt: skip
LIBRARY_ERRORS = (*READ_ERRORS, struct.error, IndexError, OverflowError, AttributeError, MemoryError)
"""Exceptions that a package for one format may raise at a damaged file, besides its own."""


class ArraySource:
    """Columns that can be read by range; subclasses fill ``_columns`` and say how to read."""

    sha256 = ""  # such a file is not read from end to end

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rate_hz: float | None = None
        self._lengths: dict[str, int] = {}
        self._types: dict[str, np.dtype[Any]] = {}
        self._scales: dict[str, tuple[float, float]] = {}
        self.left_out: dict[str, str] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Every column."""
        return tuple(self._lengths)

    def _offer(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        """Take an array into the table: a vector as it is, a matrix column by column."""
        if not shape or max(shape) < 2:
            return
        if dtype.kind not in "iufb":
            self.left_out[name] = _KINDS.get(dtype.kind, f"type {dtype}")
            return
        if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            self._lengths[name], self._types[name] = max(shape), dtype
        elif len(shape) == 2 and shape[1] <= _MOST_COLUMNS:
            for i in range(shape[1]):
                self._lengths[f"{name}[{i}]"], self._types[f"{name}[{i}]"] = shape[0], dtype
        else:
            wide = f"{shape[1]} columns, at most {_MOST_COLUMNS} are read"
            self.left_out[name] = wide if len(shape) == 2 else f"{len(shape)} dimensions"

    def _offer_rate(self, name: str, value: Any) -> None:
        number = np.asarray(value)
        if split_name(name)[0] in RATE_NAMES and number.size == 1 and np.issubdtype(number.dtype, np.number):
            self.rate_hz = float(number.reshape(()))

    def scale(self, name: str, range_v: float) -> tuple[float, float]:
        """Scale that the file states, or one."""
        return self._scales.get(name, (1.0, 0.0))

    def dtype(self, name: str) -> np.dtype[Any]:
        """Type of the column in little-endian order."""
        dtype = self._types[name]
        if dtype.kind == "b":
            return np.dtype("i1")
        return np.dtype("<f8") if dtype.kind == "f" and dtype.itemsize > 8 else dtype.newbyteorder("<")

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        raise NotImplementedError

    def _refuse_claims(self, name: str) -> None:
        """Refuse a column that claims more than the file can hold; a format that states no sizes refuses none."""

    def _refuse_size(self, name: str, claimed: int, stored: int) -> None:
        """Refuse ``claimed`` bytes of content in ``stored`` bytes of file."""
        if claimed > max(MOST_PACKED * stored, SMALL_BYTES):
            raise InputError(
                f"{self.path}: {listed([name])} claims {claimed} bytes of numbers in {stored} bytes of file; it is "
                "damaged or made up."
            )

    def pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns, some rows at a time; rows are numbered from 1."""
        lengths = {name: self._lengths[name] for name in names}
        length = min(lengths.values())
        if length < max(lengths.values()):
            each = ", ".join(f"{name} {n}" for name, n in lengths.items())
            raise InputError(
                f"{self.path}: the columns have different lengths ({each} values); the first row that is not whole "
                f"is row {length + 1}."
            )
        for name in names:
            self._refuse_claims(name)
        for start in range(0, length, PIECE_ROWS):
            stop = min(start + PIECE_ROWS, length)
            try:
                columns = {n: self._read(n, start, stop).astype(self.dtype(n), copy=False) for n in names}
            except READ_ERRORS as error:
                raise InputError(f"{self.path}: rows {start + 1} to {stop} do not read: {error}") from error
            short = [n for n in names if len(columns[n]) != stop - start]
            if short:
                raise InputError(f"{self.path}: {listed(short)}: breaks off within rows {start + 1} to {stop}.")
            yield Piece(columns, range(start + 1, stop + 1))


def split_index(name: str) -> tuple[str, int | None]:
    """``data[2]`` is column 2 of the matrix ``data``."""
    if name.endswith("]") and "[" in name:
        stem, _, index = name[:-1].rpartition("[")
        return stem, int(index)
    return name, None


class HeldSource(ArraySource):
    """Arrays that are in memory, or mapped into it."""

    def _hold(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self._arrays = dict(arrays)
        for name, array in arrays.items():
            self._offer_rate(name, array)
            self._offer(name, array.shape, array.dtype)

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        if name in self._arrays:
            return np.asarray(self._arrays[name].reshape(-1)[start:stop])
        stem, column = split_index(name)
        return np.asarray(self._arrays[stem][start:stop, column])
