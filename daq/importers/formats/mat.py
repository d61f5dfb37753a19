"""MATLAB files as tables: up to version 7.2 through SciPy, from 7.3 on as HDF5."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_PACKED, READ_ERRORS, SMALL_BYTES, HeldSource
from daq.importers.formats.hdf5 import Hdf5Source
from daq.setup.errors import InputError

_MAT_PACKED = 20  # stricter limit on compression, because these files are held in memory whole: a hundredfold
_MAT_COMPRESSED = 15  # type number of a compressed element


class Mat73Source(Hdf5Source):
    """Variables of a MATLAB file from version 7.3 on: HDF5, its matrices lying column by column."""

    def _offer(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        if not name.startswith("#") and self._file[name].attrs.get("MATLAB_class", b"") != b"char":
            super()._offer(name, shape[::-1], dtype)

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        item, column = self._opened(name)
        if column is None:
            return np.asarray(item[start:stop] if item.shape[0] > 1 else item[0, start:stop]).ravel()
        return np.asarray(item[column, start:stop])


def _unpacked_bytes(path: Path) -> int:
    """Bytes of all variables of a MATLAB 5 file, unpacked piece by piece; no more than is believed is unpacked."""
    total, most = 0, MOST_PACKED * (path.stat().st_size // _MAT_PACKED) + SMALL_BYTES
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


class MatSource(HeldSource):
    """Variables of a MATLAB file up to version 7.2 (7.3 is HDF5: `Mat73Source`)."""

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        super().__init__(path)
        try:
            self._refuse_size("a variable", _unpacked_bytes(path), path.stat().st_size // _MAT_PACKED)
            variables = loadmat(str(path))
        except (*READ_ERRORS, MatReadError, MemoryError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: cannot be read as MAT ({error}).") from error
        self._hold({k: v for k, v in variables.items() if isinstance(v, np.ndarray) and not k.startswith("__")})
