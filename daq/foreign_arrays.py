"""Numbers in arrays: HDF5, NPZ, MAT and WAV files as tables of columns of equal length.

The rule kept here: numbers keep the type they have in the file; a file's own scale (`scale_factor`, a WAV's full
scale) is stored beside them, never applied to them.
"""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.errors import InputError
from daq.foreign import PIECE_ROWS, RATE_NAMES, Piece, split_name

_MOST_COLUMNS = 64


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
        return np.dtype("i1") if dtype.kind == "b" else dtype.newbyteorder("<")

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

    def pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns, some rows at a time; rows are numbered from 1."""
        length = self._length(names)
        for start in range(0, length, PIECE_ROWS):
            stop = min(start + PIECE_ROWS, length)
            try:
                columns = {n: self._read(n, start, stop).astype(self.dtype(n), copy=False) for n in names}
            except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
                raise InputError(f"{self.path}: rows {start + 1} to {stop} do not read: {error}") from error
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
        try:
            self._file = h5py.File(path, "r")
        except OSError as error:
            raise InputError(f"{path}: cannot be read as HDF5 ({error}).") from error
        self._fields: dict[str, tuple[str, str]] = {}
        for key, value in self._file.attrs.items():
            self._offer_rate(key, value)
        self._file.visititems(self._visit)

    def _visit(self, name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        if item.dtype.names:
            for field in item.dtype.names:
                key = f"{name}/{field}"
                self._offer(key, item.shape, item.dtype[field])
                self._fields[key] = (name, field)
            return
        if item.shape in ((), (1,)):
            self._offer_rate(name, item[()])
        self._offer(name, item.shape, item.dtype)
        if "scale_factor" in item.attrs:
            self._scales[name] = (float(item.attrs["scale_factor"]), float(item.attrs.get("add_offset", 0.0)))
        units = item.attrs.get("units")
        if split_name(name)[0] in ("timestamp", "timestamps") and isinstance(units, str):
            self.time_unit = {"n": "ns", "1": "ns", "u": "us", "m": "ms", "s": "s"}.get(units[:1], "")

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


class NpzSource(_ArraySource):
    """Arrays of an NPZ file, read piece by piece from the archive."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._shapes: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}
        self._open: dict[str, tuple[Any, int]] = {}
        try:
            self._archive = zipfile.ZipFile(path)
            for member in self._archive.namelist():
                with self._archive.open(member) as stream:
                    shape, order, dtype = _npy_header(stream)
                    name = member.removesuffix(".npy")
                    if shape in ((), (1,)) and dtype.kind in "iuf":
                        self._offer_rate(name, np.frombuffer(stream.read(dtype.itemsize), dtype)[0])
                if len(shape) == 2 and 1 not in shape and order:
                    continue  # column-major matrices cannot be read row by row; nobody needs them here
                self._shapes[name] = (shape, dtype)
                self._offer(name, shape, dtype)
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            raise InputError(f"{path}: cannot be read as NPZ ({error}).") from error

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        """Columns are read in order, so each keeps its place in the archive."""
        stem, column = (name, None) if name in self._shapes else _split_index(name)
        shape, dtype = self._shapes[stem]
        width = shape[1] if column is not None else 1
        stream, at = self._open.get(name, (None, -1))
        if at != start:
            stream = self._archive.open(stem + ".npy")
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


class MatSource(_HeldSource):
    """Variables of a MATLAB file up to version 7.2 (7.3 is HDF5: give it the ending .h5)."""

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat

        super().__init__(path)
        try:
            variables = loadmat(str(path))
        except (ValueError, NotImplementedError, OSError) as error:
            raise InputError(f"{path}: cannot be read as MAT ({error}); end a version 7.3 file in .h5.") from error
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
        except (ValueError, OSError) as error:
            raise InputError(f"{path}: cannot be read as WAV ({error}).") from error
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
