"""Base class of the binary importers: arrays of a file as a table of columns of equal length.

Numbers keep the type they have in the file. A file's own scale (`scale_factor`, a WAV's full scale) is stored with
them and never applied to them.
"""

from __future__ import annotations

import contextlib
import struct
import weakref
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.columns import PIECE_ROWS, RATE_NAMES, Piece, Source, listed, split_name
from daq.setup.errors import InputError

MOST_OBJECTS = 10_000  # most datasets and groups of one file
MOST_PACKED = 2000  # largest credible compression factor of a measurement
SMALL_BYTES = 1 << 24  # content below this size is read whatever its compression
_KINDS = {"c": "complex numbers", "S": "text", "U": "text", "O": "text or lists", "M": "dates", "m": "durations"}
DAMAGE: tuple[type[Exception], ...] = (
    OSError, ValueError, EOFError, RuntimeError, NotImplementedError, KeyError, TypeError, zlib.error,
    zipfile.BadZipFile, struct.error, IndexError, OverflowError, AttributeError, MemoryError,
)  # fmt: skip
"""Exceptions that a package for one format may raise at a damaged file, besides its own."""

Read = Callable[[int, int, int | None], NDArray[Any]]
"""Gives values ``start`` to ``stop`` of a vector, or of column ``k`` of a matrix."""


@contextlib.contextmanager
def refusals(path: Path, what: str, *further: type[Exception]) -> Iterator[None]:
    """Turn whatever a damaged file makes a package raise into an `InputError`: ``path: what (error)``."""
    try:
        yield
    except InputError:
        raise
    except (*DAMAGE, *further) as error:
        raise InputError(f"{path}: {what} ({error}).") from error


@dataclass(frozen=True)
class _Array:
    """A column: its length, how it is read, bytes of which it is made in the file, and its scale."""

    length: int
    dtype: np.dtype[Any]
    read: Callable[[int, int], NDArray[Any]]
    refuse_claims: Callable[[], None]
    scale: tuple[float, float]


class ArraySource(Source):
    """Columns that can be read by range; subclasses offer the arrays of their file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._columns: dict[str, _Array] = {}

    def _handle(self) -> BinaryIO:
        """The open file, closed with the source: neither a library nor a source does it."""
        handle = self.path.open("rb")
        weakref.finalize(self, handle.close)
        return handle

    def _offer(
        self,
        name: str,
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
        read: Read,
        stored: Callable[[], int] | None = None,
        scale: tuple[float, float] = (1.0, 0.0),
    ) -> None:
        """Take an array into the table: a vector as it is, a matrix column by column.

        Parameters
        ----------
        stored
            Gives the bytes of file that hold the array; may refuse it. None: all of the file.
        scale
            Volts of one unit, and of 0.
        """
        if not shape or max(shape) < 2:
            return
        if dtype.kind not in "iufb":
            self.left_out[name] = _KINDS.get(dtype.kind, f"type {dtype}")
            return

        def refuse_claims() -> None:
            # what an array claims is not believed: memory for it is taken only where the file can hold it
            claimed = int(np.prod(shape, dtype=np.float64)) * dtype.itemsize
            self._refuse_size(name, claimed, stored() if stored is not None else self.path.stat().st_size)

        if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            self._columns[name] = _Array(max(shape), dtype, lambda a, b: read(a, b, None), refuse_claims, scale)
        elif len(shape) == 2 and shape[1] <= 64:
            for k in range(shape[1]):
                own = partial(lambda k, a, b: read(a, b, k), k)
                self._columns[f"{name}[{k}]"] = _Array(shape[0], dtype, own, refuse_claims, scale)
        else:
            wide = f"{shape[1]} columns, at most 64 are read"
            self.left_out[name] = wide if len(shape) == 2 else f"{len(shape)} dimensions"
        self.names = tuple(self._columns)

    def _offer_rate(self, name: str, value: Any) -> None:
        """Take a single number with the name of a rate for one."""
        number = np.asarray(value)
        if split_name(name)[0] in RATE_NAMES and number.size == 1 and np.issubdtype(number.dtype, np.number):
            self.rate_hz = float(number.reshape(()))

    def _hold(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take arrays that are in memory, or mapped into it."""

        def read(array: NDArray[Any], start: int, stop: int, column: int | None) -> NDArray[Any]:
            return np.asarray(array.reshape(-1)[start:stop] if column is None else array[start:stop, column])

        for name, array in arrays.items():
            self._offer_rate(name, array)
            self._offer(name, array.shape, array.dtype, partial(read, array))

    def _refuse_size(self, name: str, claimed: int, stored: int) -> None:
        """Refuse ``claimed`` bytes of content in ``stored`` bytes of file."""
        if claimed > max(MOST_PACKED * stored, SMALL_BYTES):
            raise InputError(
                f"{self.path}: {listed([name])} claims {claimed} bytes of numbers in {stored} bytes of file; it is "
                "damaged or made up."
            )

    def scale(self, name: str, range_v: float) -> tuple[float, float]:
        """Scale that the file states, or one."""
        return self._columns[name].scale

    def dtype(self, name: str) -> np.dtype[Any]:
        """Type of the column in little-endian order."""
        dtype = self._columns[name].dtype
        if dtype.kind == "b":
            return np.dtype("i1")
        return np.dtype("<f8") if dtype.kind == "f" and dtype.itemsize > 8 else dtype.newbyteorder("<")

    def pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns, some rows at a time; rows are numbered from 1."""
        lengths = {name: self._columns[name].length for name in names}
        length = min(lengths.values())
        if length < max(lengths.values()):
            each = ", ".join(f"{name} {n}" for name, n in lengths.items())
            raise InputError(
                f"{self.path}: the columns have different lengths ({each} values); the first row that is not whole "
                f"is row {length + 1}."
            )
        for name in names:
            self._columns[name].refuse_claims()
        for start in range(0, length, PIECE_ROWS):
            stop = min(start + PIECE_ROWS, length)
            with refusals(self.path, f"rows {start + 1} to {stop} do not read"):
                columns = {n: self._columns[n].read(start, stop).astype(self.dtype(n), copy=False) for n in names}
            short = [n for n in names if len(columns[n]) != stop - start]
            if short:
                raise InputError(f"{self.path}: {listed(short)}: breaks off within rows {start + 1} to {stop}.")
            yield Piece(columns, range(start + 1, stop + 1))
