"""WAV files as tables: whole numbers are codes of full scale, floats are volts."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import READ_ERRORS, HeldSource
from daq.setup.errors import InputError


class WavSource(HeldSource):
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
        except UnboundLocalError as error:  # SciPy's, for a file that ends before its first sample
            raise InputError(f"{path}: cannot be read as WAV (cut off before its samples); copy it again.") from error
        except (*READ_ERRORS, ZeroDivisionError) as error:
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
