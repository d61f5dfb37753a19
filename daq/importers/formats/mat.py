"""MATLAB files up to version 7.2 as tables, through SciPy; from 7.3 on they are HDF5."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Literal

import numpy as np

from daq.importers.formats.arrays import MOST_PACKED, SMALL_BYTES, ArraySource, refusals

_PACKED = 20  # stricter limit on compression, because these files are held in memory whole: a hundredfold


class MatSource(ArraySource):
    """Variables of a MATLAB file up to version 7.2 (7.3: `daq.importers.formats.hdf5.Mat73Source`)."""

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        super().__init__(path)
        with refusals(path, "cannot be read as MAT", MatReadError):
            self._refuse_size("a variable", _unpacked_bytes(path), path.stat().st_size // _PACKED)
            variables = loadmat(str(path))
        self._hold({k: v for k, v in variables.items() if isinstance(v, np.ndarray) and not k.startswith("__")})


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
