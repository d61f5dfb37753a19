"""WAV files read piece by piece: whole numbers of 8 to 32 bit and floats, also with sizes that were never filled in.

Decision 314.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.setup.errors import InputError
from kernels.arrays import Floats

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE  # kinds of samples; the last: the kind stands in a longer header
_TYPES = {(_PCM, 1): "u1", (_PCM, 2): "i2", (_PCM, 3): "i4", (_PCM, 4): "i4", (_PCM, 8): "i8",
          (_FLOAT, 4): "f4", (_FLOAT, 8): "f8"}  # fmt: skip
_RIFFS = (b"RIFF", b"RIFX", b"RF64")


@dataclass(frozen=True)
class Wav:
    """An open WAV file."""

    rate_hz: float
    channels: int
    n_samples: int  # samples a channel
    path: Path
    start: int  # byte at which the samples start
    width: int  # bytes a sample in the file; 3 is read as 4
    dtype: np.dtype[Any]  # of the samples as they are read

    def codes(self, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Samples ``start`` to ``stop`` as they are, (n, channels); 24 bit are the upper ones of 32."""
        stop = self.n_samples if stop is None else min(stop, self.n_samples)
        frame = self.width * self.channels
        with self.path.open("rb") as file:  # not mapped: pages once read would stay in memory
            file.seek(self.start + start * frame)
            raw = np.frombuffer(file.read(max(stop - start, 0) * frame), dtype=np.uint8)
        if self.width == 3:
            at = slice(1, 4) if self.dtype.str[0] != ">" else slice(0, 3)
            wide = np.zeros((len(raw) // 3, 4), dtype=np.uint8)
            wide[:, at] = raw.reshape(-1, 3)
            raw = wide.reshape(-1)
        return raw.view(self.dtype).reshape(-1, self.channels)

    def read(self, start: int = 0, stop: int | None = None) -> Floats:
        """Samples ``start`` to ``stop``, (n, channels), full scale 1."""
        codes = self.codes(start, stop)
        if self.dtype.kind == "f":
            return codes.astype(np.float64)
        middle = 128.0 if self.dtype.kind == "u" else 0.0
        return (codes - middle) / 2.0 ** (8 * self.dtype.itemsize - 1)

    def envelope(self, start_s: float, stop_s: float, columns: int) -> tuple[Floats, Floats, Floats]:
        """Time, lowest and highest sample of all channels, in at most ``columns`` columns; read in pieces."""
        first = max(int(start_s * self.rate_hz), 0)
        last = min(int(stop_s * self.rate_hz), self.n_samples)
        step = max(-(-(last - first) // max(columns, 1)), 1)
        at, low, high = [np.empty(0)], [np.empty(0)], [np.empty(0)]
        piece = max((1 << 20) // step, 1) * step
        for begin in range(first, last, piece):
            samples = self.read(begin, min(begin + piece, last))
            if not len(samples):
                break  # the file became shorter meanwhile
            edges = np.arange(0, len(samples), step)
            at.append((begin + edges) / self.rate_hz)
            low.append(np.minimum.reduceat(samples, edges).min(axis=1))
            high.append(np.maximum.reduceat(samples, edges).max(axis=1))
        return np.concatenate(at), np.concatenate(low), np.concatenate(high)


def is_wav(path: Path) -> bool:
    """Whether a file begins as a WAV file does."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(12)
    return head[:4] in _RIFFS and head[8:12] == b"WAVE"


def open_wav(path: Path) -> Wav:
    """The samples of ``path``, not yet read; raises `OSError`, `InputError` for other than whole numbers or floats."""
    size = path.stat().st_size
    kind = channels = rate = bits = 0
    with path.open("rb") as file:
        order = ">" if file.read(12)[:4] == b"RIFX" else "<"
        while len(chunk := file.read(8)) == 8:
            name, length = struct.unpack(order + "4sI", chunk)
            here = file.tell()
            if name == b"fmt " and length >= 16:
                body = file.read(min(length, 40))
                kind, channels, rate, _, _, bits = struct.unpack(order + "HHIIHH", body[:16].ljust(16, b"\0"))
                if kind == _EXTENSIBLE and len(body) >= 26:  # the kind is the start of a GUID
                    kind = struct.unpack(order + "H", body[24:26])[0]
            elif name == b"data":
                break
            file.seek(here + length + length % 2)
        else:
            raise InputError(
                f"{path}: cannot be read as WAV (it ends before its samples); copy it again, or export it as 16-bit "
                "PCM WAV."
            )
    width = (bits + 7) // 8
    if (kind, width) not in _TYPES or channels < 1 or rate < 1:
        raise InputError(
            f"{path}: cannot be read as WAV (format {kind}, {bits} bit, {channels} channels at {rate} Hz); export it "
            "as 16-bit PCM WAV."
        )
    n_samples = min(length, size - here) // (width * channels)  # a recorder that was cut off leaves any length
    return Wav(float(rate), channels, n_samples, path, here, width, np.dtype(order + _TYPES[kind, width]))
