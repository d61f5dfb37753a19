"""HDF5 files as tables: datasets, matrix columns and fields of compound types."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_OBJECTS, READ_ERRORS, ArraySource, split_index
from daq.importers.formats.columns import RATE_NAMES, listed, split_name
from daq.setup.errors import InputError

_MOST_ROW_BYTES = 4096  # longest row of a table
_MOST_CHUNK_BYTES = 1 << 28  # largest chunk that is unpacked at once


class Hdf5Source(ArraySource):
    """Every one-dimensional dataset, every column of a matrix and every field of a table of an HDF5 file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._fields: dict[str, tuple[str, str]] = {}
        self._open: dict[str, tuple[Any, int | None]] = {}
        self._n_objects = 0
        try:
            self._file = h5py.File(path, "r")
            for key in self._file.attrs:
                if split_name(key)[0] in RATE_NAMES and self._file.attrs.get_id(key).shape in ((), (1,)):
                    self._offer_rate(key, self._file.attrs[key])
            self._file.visititems(self._visit)  # follows no soft or external link, and each object once
        except READ_ERRORS as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: cannot be read as HDF5 ({error}).") from error

    def _visit(self, name: str, item: Any) -> None:
        self._n_objects += 1
        if self._n_objects > MOST_OBJECTS:
            raise InputError(
                f"{self.path}: holds more than {MOST_OBJECTS} datasets and groups; put the columns into a file of "
                "their own."
            )
        if not isinstance(item, h5py.Dataset):
            return
        if item.is_virtual or item.external:  # what lies in another file is not this file's to give
            self.left_out[name] = "kept in another file"
            return
        if item.dtype.itemsize > _MOST_ROW_BYTES:
            self.left_out[name] = f"rows of {item.dtype.itemsize} bytes, at most {_MOST_ROW_BYTES} are read"
            return
        if item.dtype.names:
            for field in item.dtype.names:
                key = f"{name}/{field}"
                self._offer(key, item.shape, item.dtype[field])
                self._fields[key] = (name, field)
            return
        # a number with the name of a rate is one
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
        stem = self._fields[name][0] if name in self._fields else name if name in self._file else split_index(name)[0]
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
        item, column = self._opened(name)
        if column is None:
            return np.asarray(item[start:stop] if item.ndim == 1 or item.shape[1] == 1 else item[0, start:stop]).ravel()
        return np.asarray(item[start:stop, column])

    def _opened(self, name: str) -> tuple[Any, int | None]:
        """The dataset of a column and the column's number in a matrix; each stays open and keeps its last chunks."""
        if name not in self._open:
            stem, column = (name, None) if name in self._file else split_index(name)
            self._open[name] = self._file[stem], column
        return self._open[name]


def _small_attribute(item: Any, key: str) -> float | str | None:
    """A number or a text of an HDF5 dataset; None where it is absent or something else."""
    if key not in item.attrs or item.attrs.get_id(key).shape not in ((), (1,)):
        return None
    value = np.asarray(item.attrs[key]).reshape(-1)[0]
    if isinstance(value, str):
        return value
    return float(value) if np.issubdtype(type(value), np.number) and not np.iscomplexobj(value) else None
