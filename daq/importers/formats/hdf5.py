"""HDF5 files as tables: datasets, matrix columns and fields of compound types; MATLAB files from version 7.3 on too."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_OBJECTS, ArraySource, refusals
from daq.importers.formats.columns import RATE_NAMES, listed, split_name
from daq.setup.errors import InputError

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
        if item.shape in ((), (1,)) and split_name(name)[0] in RATE_NAMES:
            self._offer_rate(name, item[()])
        factor, offset = (_small_attribute(item, key) for key in ("scale_factor", "add_offset"))
        scale = (factor, offset if isinstance(offset, float) else 0.0) if isinstance(factor, float) else (1.0, 0.0)
        self._offer(name, item.shape, item.dtype, partial(self._read, name), partial(self._stored, name), scale)
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

    def _read(self, name: str, start: int, stop: int, column: int | None) -> NDArray[Any]:
        item = self._dataset(name)
        if column is None:
            return np.asarray(item[start:stop] if item.ndim == 1 or item.shape[1] == 1 else item[0, start:stop]).ravel()
        return np.asarray(item[start:stop, column])


class Mat73Source(Hdf5Source):
    """Variables of a MATLAB file from version 7.3 on: HDF5, its matrices lying column by column."""

    def _take(self, name: str, item: Any) -> None:
        if item.size == 1:
            self._offer_rate(name, item[()])
        if not name.startswith("#") and item.attrs.get("MATLAB_class", b"") != b"char":
            self._offer(name, item.shape[::-1], item.dtype, partial(self._read, name), partial(self._stored, name))

    def _read(self, name: str, start: int, stop: int, column: int | None) -> NDArray[Any]:
        item = self._dataset(name)
        if column is None:
            return np.asarray(item[start:stop] if item.shape[0] > 1 else item[0, start:stop]).ravel()
        return np.asarray(item[column, start:stop])


def _small_attribute(item: Any, key: str) -> float | str | None:
    """A number or a text of an HDF5 dataset; None where it is absent or something else."""
    if key not in item.attrs or item.attrs.get_id(key).shape not in ((), (1,)):
        return None
    value = np.asarray(item.attrs[key]).reshape(-1)[0]
    if isinstance(value, str):
        return value
    return float(value) if np.issubdtype(type(value), np.number) and not np.iscomplexobj(value) else None
