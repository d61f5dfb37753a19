"""WAV files as tables: whole numbers are codes of full scale, floats are volts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daq.channels.registry import CHANNELS
from daq.files.wav import open_wav
from daq.importers.formats.arrays import ArraySource
from daq.setup.errors import InputError


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
