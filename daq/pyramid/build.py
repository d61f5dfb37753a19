"""The pyramid of a recording, made in one pass over its samples. Memory holds the extremes, a thirtieth of them.

The file is a header of JSON, then the extremes of every level and channel, one after the other. Buckets begin anew
after every gap, so that none holds samples from both sides of it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import struct
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import CHUNK_SAMPLES
from daq.recording import Recording
from daq.recording.header import stored_id
from kernels import njit
from kernels.arrays import Integers

MAGIC = b"SBPYRAM1"
HEAD = struct.Struct("<8sQII")
"""Magic, length of the JSON, its CRC-32, the CRC-32 of the extremes."""
BUCKET, FACTOR = 64, 4
"""Samples in a bucket of the lowest level, and buckets in one of the next level."""
TOP_BUCKETS = 1024
"""Buckets of the whole recording, for a stretch without gaps, below which no further level is made."""


@dataclass(frozen=True)
class Layout:
    """Places of a recording's extremes in the file."""

    key: str  # hash of the channels, checksums and gaps that the pyramid was made of
    rate_hz: float
    n_samples: int
    # Name, type and scale (volts a code, volts at zero) of each channel
    channels: tuple[tuple[str, str, float, float], ...]
    gaps: tuple[tuple[int, int], ...]  # ``(first sample after it, samples lost)`` each
    levels: int  # number of levels

    @classmethod
    def of(cls, recording: Recording, key: str) -> Layout:
        """Layout for an open recording."""
        kinds = {name: recording.codes(name, 0, 0).dtype for name in recording.channels}
        channels = tuple((name, kinds[name].newbyteorder("<").str, *recording.scale(name)) for name in kinds)
        levels = 1
        while recording.n_samples / (BUCKET * FACTOR ** (levels - 1)) > TOP_BUCKETS:
            levels += 1
        gaps = tuple((int(first), int(lost)) for first, lost in recording.gaps)
        return cls(key, recording.rate_hz, recording.n_samples, channels, gaps, levels)

    @cached_property
    def starts(self) -> Integers:
        """First sample of each stretch without gaps, and the number of samples, (s + 1,)."""
        inside = [first for first, _ in self.gaps if 0 < first < self.n_samples]
        return np.unique(np.array([0, *inside, self.n_samples], np.int64))

    @cached_property
    def lost_before(self) -> Integers:
        """Samples lost before each stretch, (s,)."""
        lost = np.zeros(len(self.starts) - 1, np.int64)
        for first, n in self.gaps:
            lost[np.searchsorted(self.starts[:-1], first) :] += n
        return lost

    @cached_property
    def places(self) -> int:
        """Samples from the first to the last, the lost ones included."""
        return self.n_samples + (int(self.lost_before[-1]) if len(self.lost_before) else 0)

    @cached_property
    def first_buckets(self) -> list[Integers]:
        """By level, the first bucket of each stretch, and the number of buckets, (s + 1,)."""
        counts, out = -(-np.diff(self.starts) // BUCKET), []
        for _ in range(self.levels):
            out.append(np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))
            counts = -(-counts // FACTOR)
        return out

    def bucket(self, level: int) -> int:
        """Samples in a bucket of a level."""
        return int(BUCKET * FACTOR**level)

    def dtype(self, channel: int) -> np.dtype[Any]:
        """Type of a channel's samples."""
        return np.dtype(self.channels[channel][1])

    def offset(self, level: int, channel: int, most: int) -> int:
        """Byte, after the header, at which the minima (``most`` 0) or maxima (1) of a level and channel begin."""
        sizes = [self.dtype(c).itemsize for c in range(len(self.channels))]
        below = 2 * sum(sizes) * sum(int(own[-1]) for own in self.first_buckets[:level])
        if level == self.levels:
            return below
        return below + int(self.first_buckets[level][-1]) * (2 * sum(sizes[:channel]) + most * sizes[channel])

    def header(self, body_crc32: int) -> bytes:
        """The header of the file."""
        text = json.dumps(dataclasses.asdict(self)).encode()
        return HEAD.pack(MAGIC, len(text), zlib.crc32(text), body_crc32) + text


def read_layout(path: Path) -> tuple[Layout, int, int] | None:
    """Layout of a file, where its extremes begin, and their CRC-32; None where the file is no sound pyramid."""
    with path.open("rb") as raw:
        head = raw.read(HEAD.size)
        if len(head) < HEAD.size or head[: len(MAGIC)] != MAGIC:
            return None
        _, length, crc, body_crc32 = HEAD.unpack(head)
        text = raw.read(min(length, 1 << 28))
        size = raw.seek(0, 2)
    if zlib.crc32(text) != crc:
        return None
    header = json.loads(text)
    for name in ("channels", "gaps"):
        header[name] = tuple(map(tuple, header[name]))
    layout = Layout(**header)
    begin = HEAD.size + len(text)
    return (layout, begin, body_crc32) if size == begin + layout.offset(layout.levels, 0, 0) else None


PIECE = 4 * CHUNK_SAMPLES
"""Samples read at a time."""


def pyramid_key(recording: Recording) -> str:
    """Hash of a pyramid's source: the stored checksums (of a run that goes on: of its blocks), and the gaps."""
    blocks = "" if recording.frames is None else hashlib.sha256(recording.blocks["crc32"].tobytes()).hexdigest()
    made_of = [stored_id(recording), blocks, recording.channels, recording.n_samples, recording.gaps.tolist()]
    return hashlib.sha256(json.dumps(made_of).encode()).hexdigest()[:32]


def has_pyramid(path: Path, key: str) -> bool:
    """Whether the file ``path`` is a whole pyramid of the source with the hash ``key``."""
    try:
        found = read_layout(path)
    except (OSError, ValueError, TypeError, KeyError):
        return False
    if found is None or found[0].key != key:
        return False
    with path.open("rb") as raw:
        raw.seek(found[1])
        return zlib.crc32(raw.read()) == found[2]


def build_pyramid(recording: Recording, path: Path, progress: Callable[[float], None] | None = None) -> Layout:
    """Write the pyramid of an open recording to ``path``, whole or not at all.

    Parameters
    ----------
    recording
        Open; read once from its first sample to its last.
    path
        File to write; one that is there is replaced.
    progress
        Called with the part done, 0 to 1.

    Raises
    ------
    OSError
        When the disk refuses.
    InputError
        When samples do not read back.
    """
    layout = Layout.of(recording, pyramid_key(recording))
    stretches, begins = layout.starts, layout.first_buckets
    extremes = [empty_extremes(int(begins[0][-1]), layout.dtype(c)) for c in range(len(layout.channels))]
    for start in range(0, recording.n_samples, PIECE):
        stop = min(start + PIECE, recording.n_samples)
        of = range(int(np.searchsorted(stretches, start, "right")) - 1, int(np.searchsorted(stretches, stop, "left")))
        for (name, dtype, *_), (low, high) in zip(layout.channels, extremes, strict=True):
            codes = recording.codes(name, start, stop).astype(dtype, copy=False)
            for k in of:  # no bucket holds samples of two stretches
                a, b = max(start, int(stretches[k])), min(stop, int(stretches[k + 1]))
                at, skipped = divmod(a - int(stretches[k]), BUCKET)
                at += int(begins[0][k])
                fold_samples(codes[a - start : b - start], skipped, BUCKET, low[at:], high[at:])
        if progress is not None:
            progress(stop / recording.n_samples)
    body = [x.tobytes() for pair in extremes for x in pair]
    for below, here in pairwise(begins):
        buckets = np.arange(int(here[-1]))
        stretch = np.searchsorted(here, buckets, "right") - 1
        first = below[stretch] + FACTOR * (buckets - here[stretch])
        extremes = [(np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)) for low, high in extremes]
        body += [x.tobytes() for pair in extremes for x in pair]
    crc = 0
    for part in body:
        crc = zlib.crc32(part, crc)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines([layout.header(crc), *body])
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return layout


def empty_extremes(n: int, dtype: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Minima and maxima (n,) of no samples: the least is greater than the greatest."""
    limits = (np.inf, -np.inf) if dtype.kind == "f" else (np.iinfo(dtype).max, np.iinfo(dtype).min)
    return np.full(n, limits[0], dtype), np.full(n, limits[1], dtype)


@njit(nogil=True)
def fold_samples(codes: NDArray[Any], skipped: int, bucket: int, low: NDArray[Any], high: NDArray[Any]) -> None:
    """Widen the extremes ``low``, ``high`` (k,) of buckets by samples (n,) that do not jump over lost ones.

    Parameters
    ----------
    codes
        Samples; one that is no number (NaN) is passed over.
    skipped
        Samples of the first bucket that came before.
    bucket
        Samples a bucket.
    low, high
        Extremes so far; ``low > high``: none yet.
    """
    at, k, n = 0, 0, len(codes)
    end = min(bucket - skipped, n)
    while at < n:
        least, most = low[k], high[k]
        for i in range(at, end):
            x = codes[i]
            least = x if x < least else least
            most = x if x > most else most
        low[k], high[k] = least, most
        at, end, k = end, min(end + bucket, n), k + 1
