"""WAV files read piece by piece: PCM of 8 to 32 bit and float, also with sizes that were never filled in."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.setup.errors import InputError

Array = NDArray[np.float64]

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_LEAST_S = 0.05
_PIECE = 1 << 20  # samples held at once for an envelope


@dataclass(frozen=True)
class Wav:
    """An open sound.

    Attributes
    ----------
    rate_hz : float
    channels : int
    n_samples : int
        Samples a channel.
    path, kind, width, start
        File, format (PCM or float), bytes a sample, and the byte at which the samples start.
    """

    rate_hz: float
    channels: int
    n_samples: int
    path: Path
    kind: int
    width: int
    start: int

    def read(self, start: int = 0, stop: int | None = None) -> Array:
        """Samples ``start`` to ``stop``, (n, channels) float64, full scale 1."""
        stop = self.n_samples if stop is None else min(stop, self.n_samples)
        frame = self.width * self.channels
        with self.path.open("rb") as file:  # not mapped: pages once read would stay in memory
            file.seek(self.start + start * frame)
            raw = file.read(max(stop - start, 0) * frame)
        return _decoded(raw, self.kind, self.width).reshape(-1, self.channels)

    def envelope(self, start_s: float, stop_s: float, columns: int) -> tuple[Array, Array, Array]:
        """Time, lowest and highest sample of all channels, in at most ``columns`` columns; read in pieces."""
        first = max(int(start_s * self.rate_hz), 0)
        last = min(int(stop_s * self.rate_hz), self.n_samples)
        step = max(-(-(last - first) // max(columns, 1)), 1)
        at, low, high = [np.empty(0)], [np.empty(0)], [np.empty(0)]
        piece = max(_PIECE // step, 1) * step
        for begin in range(first, last, piece):
            samples = self.read(begin, min(begin + piece, last))
            edges = np.arange(0, len(samples), step)
            if len(edges):
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
    return head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE"


def open_wav(path: Path) -> Wav:
    """The sound in ``path``, not yet read.

    Raises
    ------
    InputError
        Not a WAV file of PCM or float samples, or hardly any sound in it.
    """
    size = path.stat().st_size
    header: tuple[int, int, int, int] | None = None
    with path.open("rb") as file:
        file.seek(12)
        while len(chunk := file.read(8)) == 8:
            name, length = chunk[:4], struct.unpack("<I", chunk[4:])[0]
            here = file.tell()
            if name == b"fmt " and length >= 16:
                header = _format(file.read(min(length, 40)))
            elif name == b"data" and header is not None:
                return _opened(path, header, here, min(length, size - here))
            file.seek(here + length + length % 2)
    raise InputError(f"{path}: not a readable WAV file; export it as 16-bit PCM WAV")


def _format(body: bytes) -> tuple[int, int, int, int]:
    """Kind, channels, rate and bits; the kind of an extensible header is the start of its GUID."""
    kind, channels, rate, _, _, bits = struct.unpack("<HHIIHH", body[:16])
    if kind == _EXTENSIBLE and len(body) >= 26:
        kind = struct.unpack("<H", body[24:26])[0]
    return kind, channels, rate, bits


def _opened(path: Path, header: tuple[int, int, int, int], start: int, length: int) -> Wav:
    kind, channels, rate, bits = header
    width = (bits + 7) // 8
    known = (kind == _PCM and width in (1, 2, 3, 4)) or (kind == _FLOAT and width in (4, 8))
    if not known or channels < 1 or rate < 1:
        raise InputError(f"{path}: not a readable WAV file (format {kind}, {bits} bit); export it as 16-bit PCM WAV")
    n = length // (width * channels)
    if n < _LEAST_S * rate:
        raise InputError(f"{path}: {n} samples at {rate} Hz hold no drop; the file may be cut off")
    return Wav(float(rate), channels, n, path, kind, width, start)


def _decoded(raw: bytes, kind: int, width: int) -> Array:
    if kind == _FLOAT:
        return np.frombuffer(raw, dtype="<f4" if width == 4 else "<f8").astype(np.float64)
    if width == 1:
        return (np.frombuffer(raw, dtype=np.uint8).astype(np.float64) - 128.0) / 128.0
    if width == 3:
        bytes3 = np.frombuffer(raw, dtype=np.uint8).reshape(-1, 3).astype(np.int32)
        word = bytes3[:, 0] | bytes3[:, 1] << 8 | bytes3[:, 2] << 16
        return np.where(word >= 1 << 23, word - (1 << 24), word) / float(1 << 23)
    kinds: dict[int, Any] = {2: "<i2", 4: "<i4"}
    return np.frombuffer(raw, dtype=kinds[width]) / float(1 << (8 * width - 1))
