"""Layout of a pyramid's file: a header of JSON, then the extremes of every level and channel, one after the other.

Buckets begin anew after every gap, so that none holds samples from both sides of it.
"""

from __future__ import annotations

import dataclasses
import json
import struct
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from daq.recording import Recording
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
