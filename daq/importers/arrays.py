"""Numbers in arrays: HDF5, NPZ, MAT and WAV files as tables of columns of equal length.

The rule kept here: numbers keep the type they have in the file; a file's own scale (`scale_factor`, a WAV's full
scale) is stored beside them, never applied to them.
"""

from __future__ import annotations

import math
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.importers.columns import PIECE_ROWS, RATE_NAMES, Piece, listed, split_name
from daq.setup.errors import InputError

_MOST_COLUMNS = 64
_MOST_OBJECTS = 10_000  # of one file
_MOST_ROW_BYTES = 4096  # of one row of a table
_MOST_CHUNK_BYTES = 1 << 28  # unpacked at once
_MOST_PACKED = 2000  # times smaller than its content, no measurement is
_SMALL_BYTES = 1 << 24
_READ_ERRORS = (
    OSError,
    ValueError,
    EOFError,
    RuntimeError,
    NotImplementedError,
    KeyError,
    TypeError,
    zlib.error,
    zipfile.BadZipFile,
)


class _ArraySource:
    """Columns that can be read by range; subclasses fill ``_columns`` and say how to read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rate_hz: float | None = None
        self._lengths: dict[str, int] = {}
        self._types: dict[str, np.dtype[Any]] = {}
        self._scales: dict[str, tuple[float, float]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Every column."""
        return tuple(self._lengths)

    def _offer(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        """Take an array into the table: a vector as it is, a matrix column by column."""
        if dtype.kind not in "iufb" or not shape or max(shape) < 2:
            return
        if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            self._lengths[name], self._types[name] = max(shape), dtype
        elif len(shape) == 2 and shape[1] <= _MOST_COLUMNS:
            for i in range(shape[1]):
                self._lengths[f"{name}[{i}]"], self._types[f"{name}[{i}]"] = shape[0], dtype

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

    def _length(self, names: Sequence[str]) -> int:
        lengths = {name: self._lengths[name] for name in names}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {n}" for name, n in lengths.items())
            shortest = min(lengths.values())
            raise InputError(
                f"{self.path}: the columns have different lengths ({listed} values); the first row that is not whole "
                f"is row {shortest + 1}."
            )
        return next(iter(lengths.values()))

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        raise NotImplementedError

    def _refuse_claims(self, name: str) -> None:
        """Refuse a column that says it is larger than the file can hold; here nothing is known of that."""

    def _refuse_size(self, name: str, claimed: int, stored: int) -> None:
        """Refuse ``claimed`` bytes of content in ``stored`` bytes of file."""
        if claimed > max(_MOST_PACKED * stored, _SMALL_BYTES):
            raise InputError(
                f"{self.path}: {listed([name])} claims {claimed} bytes of numbers in {stored} bytes of file; it is "
                "damaged or made up."
            )

    def pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns, some rows at a time; rows are numbered from 1."""
        length = self._length(names)
        for name in names:
            self._refuse_claims(name)
        for start in range(0, length, PIECE_ROWS):
            stop = min(start + PIECE_ROWS, length)
            try:
                columns = {n: self._read(n, start, stop).astype(self.dtype(n), copy=False) for n in names}
            except _READ_ERRORS as error:
                raise InputError(f"{self.path}: rows {start + 1} to {stop} do not read: {error}") from error
            short = [n for n in names if len(columns[n]) != stop - start]
            if short:
                raise InputError(f"{self.path}: {listed(short)}: breaks off within rows {start + 1} to {stop}.")
            yield Piece(columns, range(start + 1, stop + 1))


def _split_index(name: str) -> tuple[str, int | None]:
    """``data[2]`` is column 2 of the matrix ``data``."""
    if name.endswith("]") and "[" in name:
        stem, _, index = name[:-1].rpartition("[")
        return stem, int(index)
    return name, None


class Hdf5Source(_ArraySource):
    """Every one-dimensional dataset, every column of a matrix and every field of a table of an HDF5 file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._fields: dict[str, tuple[str, str]] = {}
        self._n_objects = 0
        try:
            self._file = h5py.File(path, "r")
            for key in self._file.attrs:
                if split_name(key)[0] in RATE_NAMES and self._file.attrs.get_id(key).shape in ((), (1,)):
                    self._offer_rate(key, self._file.attrs[key])
            self._file.visititems(self._visit)  # follows no soft or external link, and each object once
        except _READ_ERRORS as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: cannot be read as HDF5 ({error}).") from error

    def _visit(self, name: str, item: Any) -> None:
        self._n_objects += 1
        if self._n_objects > _MOST_OBJECTS:
            raise InputError(
                f"{self.path}: holds more than {_MOST_OBJECTS} datasets and groups; put the columns into a file of "
                "their own."
            )
        if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return  # what lies in another file is not this file's to give
        if item.dtype.itemsize > _MOST_ROW_BYTES:
            return
        if item.dtype.names:
            for field in item.dtype.names:
                key = f"{name}/{field}"
                self._offer(key, item.shape, item.dtype[field])
                self._fields[key] = (name, field)
            return
        if item.shape in ((), (1,)) and split_name(name)[0] in RATE_NAMES:
            self._offer_rate(name, item[()])
        self._offer(name, item.shape, item.dtype)
        numbers = [_small_attribute(item, key) for key in ("scale_factor", "add_offset")]
        if isinstance(numbers[0], float):
            self._scales[name] = (numbers[0], numbers[1] if isinstance(numbers[1], float) else 0.0)
        units = _small_attribute(item, "units")
        if split_name(name)[0] in ("timestamp", "timestamps") and isinstance(units, str):
            self.time_unit = {"n": "ns", "1": "ns", "u": "us", "m": "ms", "s": "s"}.get(units[:1], "")

    def _refuse_claims(self, name: str) -> None:
        stem = self._fields[name][0] if name in self._fields else name if name in self._file else _split_index(name)[0]
        item = self._file[stem]
        self._refuse_size(name, item.size * item.dtype.itemsize, item.id.get_storage_size())
        chunk = int(np.prod(item.chunks or (0,), dtype=np.float64)) * item.dtype.itemsize
        if chunk > _MOST_CHUNK_BYTES:
            raise InputError(
                f"{self.path}: {listed([name])} is stored in pieces of {chunk} bytes; wanted at most "
                f"{_MOST_CHUNK_BYTES}: write it again in smaller chunks."
            )

    time_unit = ""

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        if name in self._fields:
            dataset, field = self._fields[name]
            return np.asarray(self._file[dataset].fields(field)[start:stop])
        stem, column = _split_index(name)
        if name in self._file:
            item = self._file[name]
            return np.asarray(item[start:stop] if item.ndim == 1 or item.shape[1] == 1 else item[0, start:stop]).ravel()
        return np.asarray(self._file[stem][start:stop, column])


def _small_attribute(item: Any, key: str) -> float | str | None:
    """A number or a text of an HDF5 dataset; None where it is absent or something else."""
    if key not in item.attrs or item.attrs.get_id(key).shape not in ((), (1,)):
        return None
    value = np.asarray(item.attrs[key]).reshape(-1)[0]
    if isinstance(value, str):
        return value
    return float(value) if np.issubdtype(type(value), np.number) and not np.iscomplexobj(value) else None


class Mat73Source(Hdf5Source):
    """Variables of a MATLAB file from version 7.3 on: HDF5, its matrices lying column by column."""

    def _offer(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        if not name.startswith("#") and self._file[name].attrs.get("MATLAB_class", b"") != b"char":
            super()._offer(name, shape[::-1], dtype)

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        stem, column = (name, None) if name in self._file else _split_index(name)
        item = self._file[stem]
        if column is None:
            return np.asarray(item[start:stop] if item.shape[0] > 1 else item[0, start:stop]).ravel()
        return np.asarray(item[column, start:stop])


class NpzSource(_ArraySource):
    """Arrays of an NPZ file, read piece by piece from the archive."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._shapes: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}
        self._members: dict[str, str] = {}
        self._open: dict[str, tuple[Any, int]] = {}
        try:
            self._archive = zipfile.ZipFile(path)
            if len(self._archive.namelist()) > _MOST_OBJECTS:
                raise InputError(f"{path}: holds more than {_MOST_OBJECTS} arrays; keep the columns alone.")
            for member in self._archive.namelist():
                with self._archive.open(member) as stream:
                    shape, order, dtype = _npy_header(stream)
                    name = member.removesuffix(".npy")
                    if shape in ((), (1,)) and dtype.kind in "iuf":
                        self._offer_rate(name, np.frombuffer(stream.read(dtype.itemsize), dtype)[0])
                if len(shape) == 2 and 1 not in shape and order:
                    continue  # column-major matrices cannot be read row by row; nobody needs them here
                self._shapes[name] = (shape, dtype)
                self._members[name] = member
                self._offer(name, shape, dtype)
        except _READ_ERRORS as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: cannot be read as NPZ ({error}).") from error

    def _refuse_claims(self, name: str) -> None:
        stem = name if name in self._shapes else _split_index(name)[0]
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
        stem, column = (name, None) if name in self._shapes else _split_index(name)
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


class _HeldSource(_ArraySource):
    """Arrays that are in memory, or mapped into it."""

    def _hold(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self._arrays = dict(arrays)
        for name, array in arrays.items():
            self._offer_rate(name, array)
            self._offer(name, array.shape, array.dtype)

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        if name in self._arrays:
            return np.asarray(self._arrays[name].reshape(-1)[start:stop])
        stem, column = _split_index(name)
        return np.asarray(self._arrays[stem][start:stop, column])


_MAT_PACKED = 20  # MATLAB's files are held in memory whole, so less compression is believed: a hundredfold
_MAT_COMPRESSED = 15  # type of a packed element


def _unpacked_bytes(path: Path) -> int:
    """Bytes of all variables of a MATLAB 5 file, unpacked piece by piece; no more than is believed is unpacked."""
    total, most = 0, _MOST_PACKED * (path.stat().st_size // _MAT_PACKED) + _SMALL_BYTES
    with path.open("rb") as file:
        header = file.read(128)
        order: Literal["little", "big"] = "big" if header[126:128] == b"MI" else "little"
        while total <= most and len(tag := file.read(8)) == 8:
            kind, left = (int.from_bytes(tag[i : i + 4], order) for i in (0, 4))
            if kind != _MAT_COMPRESSED:
                total += left
                file.seek(left, 1)
                continue
            packed = zlib.decompressobj()
            while left > 0 and total <= most and (piece := file.read(min(left, 4096))):
                left -= len(piece)
                total += len(packed.decompress(piece))
            file.seek(left, 1)
    return total


class MatSource(_HeldSource):
    """Variables of a MATLAB file up to version 7.2 (7.3 is HDF5: `Mat73Source`)."""

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        super().__init__(path)
        try:
            self._refuse_size("a variable", _unpacked_bytes(path), path.stat().st_size // _MAT_PACKED)
            variables = loadmat(str(path))
        except (*_READ_ERRORS, MatReadError, MemoryError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: cannot be read as MAT ({error}).") from error
        self._hold({k: v for k, v in variables.items() if isinstance(v, np.ndarray) and not k.startswith("__")})


class WavSource(_HeldSource):
    """Channels of a WAV file, named 1, 2, ...; three channels are continuity, accelerometer, drive in that order.

    Whole numbers are codes: full scale is the range of the profile's channel. Floats are volts.
    """

    def __init__(self, path: Path) -> None:
        from scipy.io import wavfile

        super().__init__(path)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", wavfile.WavFileWarning)  # chunks of other programs
                rate, data = self._load(wavfile, path)
        except (*_READ_ERRORS, ZeroDivisionError) as error:
            raise InputError(f"{path}: cannot be read as WAV ({error}).") from error
        if not rate or not data.size:
            raise InputError(f"{path}: holds {data.size} numbers at {rate} samples/s; wanted a recording.")
        columns = data.reshape(len(data), -1)
        names = [str(i + 1) for i in range(columns.shape[1])]
        if len(names) == 3:
            names = ["continuity", "accelerometer", "drive"]
        self._hold({name: columns[:, i] for i, name in enumerate(names)})
        self.rate_hz = float(rate)

    @staticmethod
    def _load(wavfile: Any, path: Path) -> tuple[int, NDArray[Any]]:
        try:
            rate, data = wavfile.read(path, mmap=True)
        except ValueError:  # 24-bit files cannot be mapped
            rate, data = wavfile.read(path)
        return rate, data

    def scale(self, name: str, range_v: float) -> tuple[float, float]:
        """Full scale is ``range_v`` for whole numbers."""
        kind = self._types[name]
        if kind == np.dtype("u1"):
            return range_v / 128.0, -range_v
        return (range_v / -float(np.iinfo(kind).min), 0.0) if kind.kind == "i" else (1.0, 0.0)
