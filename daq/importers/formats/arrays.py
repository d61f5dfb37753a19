"""Arrays as a table of columns: the base of the binary importers, and NPZ, MATLAB, WAV and HDF5 files.

Numbers keep the type they have in the file. A file's own scale (`scale_factor`, a WAV's full scale) is stored with
them and never applied to them.
"""

from __future__ import annotations

import contextlib
import math
import struct
import weakref
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Literal

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.channels.registry import CHANNELS
from daq.files.wav import open_wav
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


def _is_wide(shape: tuple[int, ...]) -> bool:
    """Whether a matrix holds a channel in each row: no recording has so few samples."""
    return len(shape) == 2 and 1 < shape[0] <= 64 < shape[1]


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
        """Take an array into the table: a vector as it is, a matrix column by column; ``scale`` is volts of 1 and of 0.

        ``stored`` gives the bytes of file that hold the array, and may refuse it; None: all of the file.
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
            wide = f"{min(shape)} columns, at most 64 are read"
            self.left_out[name] = wide if len(shape) == 2 else f"{len(shape)} dimensions"
        self.names = tuple(self._columns)

    def _offer_rate(self, name: str, value: Any) -> None:
        """Take a single number with the name of a rate for one."""
        number = np.asarray(value)
        if split_name(name)[0] in RATE_NAMES and number.size == 1 and np.issubdtype(number.dtype, np.number):
            self.rate_hz = float(number.reshape(()))

    def _hold(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take arrays that are in memory, or mapped into it."""
        for name, array in arrays.items():
            self._offer_rate(name, array)
            upright = array.T if _is_wide(array.shape) else array
            read = partial(lambda x, a, b, k: np.asarray(x.reshape(-1)[a:b] if k is None else x[a:b, k]), upright)
            self._offer(name, upright.shape, array.dtype, read)

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
            if short := [n for n in names if len(columns[n]) != stop - start]:
                raise InputError(f"{self.path}: {listed(short)}: breaks off within rows {start + 1} to {stop}.")
            yield Piece(columns, range(start + 1, stop + 1))


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
                claimed = math.prod(shape) * dtype.itemsize
                wide = _is_wide(shape)
                shape = shape[::-1] if wide else shape
                # samples of a channel lie one after another, or as far from each other as the matrix is wide
                width = shape[1] if len(shape) == 2 and 1 not in shape and wide == by_columns else 1
                read = partial(self._read, member, max(shape, default=0), width, dtype)
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
        self, member: str, distance: int, width: int, dtype: np.dtype[Any], start: int, stop: int, column: int | None
    ) -> NDArray[Any]:
        """Samples of a channel, ``width`` numbers from one to the next; the next channel begins ``distance`` later."""
        stream, at = self._places.get((member, column), (None, -1))
        if at != start:
            stream = self._archive.open(member)
            _npy_header(stream)
            before = start * width + ((column or 0) * distance if width == 1 else 0)
            stream.seek(stream.tell() + before * dtype.itemsize)
        data = stream.read((stop - start) * width * dtype.itemsize)
        self._places[member, column] = stream, stop
        return np.frombuffer(data, dtype).reshape(-1, width)[:, (column or 0) if width > 1 else 0]


def _npy_header(stream: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether by columns, and type; raises ValueError for Python objects."""
    version = np.lib.format.read_magic(stream)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, by_columns, dtype = reader(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not read")
    return shape, by_columns, dtype


_PACKED = 20  # stricter limit on compression, because these files are held in memory whole: a hundredfold


class MatSource(ArraySource):
    """Variables of a MATLAB file up to version 7.2 (7.3: `Mat73Source`)."""

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        super().__init__(path)
        with refusals(path, "cannot be read as MAT", MatReadError):
            self._refuse_size("a variable", _unpacked_bytes(path), path.stat().st_size // _PACKED)
            variables = loadmat(str(path), simplify_cells=True)
        self._hold(dict(_fields(variables)))


def _fields(struct: Mapping[str, Any], within: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Arrays of a MATLAB structure and of those within it, with names as in HDF5."""
    for name, value in struct.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{within}{name}/")
        elif not name.startswith("__"):
            yield within + name, np.asarray(value)


def _unpacked_bytes(path: Path) -> int:
    """Bytes of all variables of a MATLAB 5 file, unpacked piece by piece; no more than is believed is unpacked."""
    total, most = 0, MOST_PACKED * (path.stat().st_size // _PACKED) + SMALL_BYTES
    with path.open("rb") as file:
        header = file.read(128)
        order: Literal["little", "big"] = "big" if header[126:128] == b"MI" else "little"
        while total <= most and len(tag := file.read(8)) == 8:
            kind, left = (int.from_bytes(tag[i : i + 4], order) for i in (0, 4))
            # elements of type 15 are compressed
            if kind != 15:
                total += left
                file.seek(left, 1)
                continue
            packed = zlib.decompressobj()
            while left > 0 and total <= most and (piece := file.read(min(left, 4096))):
                left -= len(piece)
                total += len(packed.decompress(piece))
            file.seek(left, 1)
    return total


class WavSource(ArraySource):
    """Channels of a WAV file, named 1, 2, ...; three channels are continuity, accelerometer, drive in that order."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            wav = open_wav(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read as WAV ({error}).") from error
        if not wav.n_samples:
            raise InputError(f"{path}: holds no samples; wanted a recording.")
        is_packed = wav.width != wav.dtype.itemsize  # 24-bit samples cannot be mapped
        shape = (wav.n_samples, wav.channels)
        columns = wav.codes() if is_packed else np.memmap(path, wav.dtype, "r", wav.start, shape)
        names = CHANNELS if wav.channels == len(CHANNELS) else [str(i + 1) for i in range(wav.channels)]
        self._hold({name: columns[:, i] for i, name in enumerate(names)})
        self.rate_hz = wav.rate_hz

    def scale(self, name: str, range_v: float) -> tuple[float, float]:
        """Full scale of whole numbers is ``range_v``, that of the profile's channel; floats are volts."""
        kind = self._columns[name].dtype
        if kind == np.dtype("u1"):
            return range_v / 128.0, -range_v
        return (range_v / -float(np.iinfo(kind).min), 0.0) if kind.kind == "i" else (1.0, 0.0)


_MOST_ROW_BYTES = 4096  # longest row of a table
_MOST_CHUNK_BYTES = 1 << 28  # largest chunk that is unpacked at once


class Hdf5Source(ArraySource):
    """Every one-dimensional dataset, every column of a matrix and every field of a table of an HDF5 file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._opened: dict[str, Any] = {}
        self._n_objects = 0
        with refusals(path, "cannot be read as HDF5"):
            self._file = h5py.File(path, "r")
            for key in self._file.attrs:
                if split_name(key)[0] in RATE_NAMES and self._file.attrs.get_id(key).shape in ((), (1,)):
                    self._offer_rate(key, self._file.attrs[key])
            self._file.visititems(self._visit)  # follows no soft or external link, and each object once

    def _visit(self, name: str, item: Any) -> None:
        """Take a dataset into the table, or note why it cannot be a column."""
        self._n_objects += 1
        if self._n_objects > MOST_OBJECTS:
            raise InputError(
                f"{self.path}: holds more than {MOST_OBJECTS} datasets and groups; put the columns into a file of "
                "their own."
            )
        if not isinstance(item, h5py.Dataset):
            return
        if item.is_virtual or item.external:  # what lies in another file is not this file's to give
            self.left_out[name] = "stored in another file"
        elif item.dtype.itemsize > _MOST_ROW_BYTES:
            self.left_out[name] = f"rows of {item.dtype.itemsize} bytes, at most {_MOST_ROW_BYTES} are read"
        elif item.dtype.names:
            for field in item.dtype.names:
                # read with the other fields of its rows; of each piece only the field stays
                read = partial(lambda field, a, b, _: np.asarray(self._dataset(name).fields(field)[a:b]), field)
                self._offer(f"{name}/{field}", item.shape, item.dtype[field], read, partial(self._stored, name))
        else:
            self._take(name, item)

    def _take(self, name: str, item: Any) -> None:
        """Take a dataset of plain numbers, with the scale and the unit that its attributes state."""
        if item.size == 1 and split_name(name)[0] in RATE_NAMES:
            self._offer_rate(name, item[()])
        factor, offset = (_small_attribute(item, key) for key in ("scale_factor", "add_offset"))
        scale = (factor, offset if isinstance(offset, float) else 0.0) if isinstance(factor, float) else (1.0, 0.0)
        wide = _is_wide(item.shape)
        shape, read = item.shape[::-1] if wide else item.shape, partial(self._read, name, wide)
        self._offer(name, shape, item.dtype, read, partial(self._stored, name), scale)
        units = _small_attribute(item, "units")
        if split_name(name)[0] in ("timestamp", "timestamps") and isinstance(units, str):
            self.time_unit = {"n": "ns", "1": "ns", "u": "us", "m": "ms", "s": "s"}.get(units[:1], "")

    def _stored(self, name: str) -> int:
        """Bytes in which a dataset is stored; refuses pieces that fill the memory."""
        item = self._dataset(name)
        chunk = int(np.prod(item.chunks or (0,), dtype=np.float64)) * item.dtype.itemsize
        size = int(item.id.get_storage_size())
        self._refuse_size(name, item.size * item.dtype.itemsize, size)
        if chunk > _MOST_CHUNK_BYTES:
            raise InputError(
                f"{self.path}: {listed([name])} is stored in pieces of {chunk} bytes; wanted at most "
                f"{_MOST_CHUNK_BYTES}: write it again in smaller chunks."
            )
        return size

    def _dataset(self, name: str) -> Any:
        """The dataset, which stays open: it keeps the chunks that it read last."""
        if name not in self._opened:
            self._opened[name] = self._file[name]
        return self._opened[name]

    def _read(self, name: str, wide: bool, start: int, stop: int, column: int | None) -> NDArray[Any]:
        item = self._dataset(name)
        if column is None:
            return np.asarray(item[start:stop] if item.ndim == 1 or item.shape[1] == 1 else item[0, start:stop]).ravel()
        return np.asarray(item[column, start:stop] if wide else item[start:stop, column])


class Mat73Source(Hdf5Source):
    """Variables of a MATLAB file from version 7.3 on: HDF5, its matrices lying column by column."""

    def _take(self, name: str, item: Any) -> None:
        if not name.startswith("#") and item.attrs.get("MATLAB_class", b"") != b"char":
            super()._take(name, item)


def _small_attribute(item: Any, key: str) -> float | str | None:
    """A number or a text of an HDF5 dataset; None where it is absent or something else."""
    if key not in item.attrs or item.attrs.get_id(key).shape not in ((), (1,)):
        return None
    value = np.asarray(item.attrs[key]).reshape(-1)[0]
    if isinstance(value, str):
        return value
    return float(value) if np.issubdtype(type(value), np.number) and not np.iscomplexobj(value) else None
