"""Recordings read piece by piece, as float32 volts, in bounded memory.

Pieces carry neighbouring samples on both sides for detectors that need the surroundings of an event.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from daq.recording import Recording
from kernels import njit

PIECE = 1 << 17  # samples of a piece
PAD = 1024  # neighbouring samples on both sides of a piece
SURVEY_PIECE, SURVEY_PIECES = 1 << 16, 5  # samples and number of the pieces of a survey

Volts = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Piece:
    """Volts of samples ``first, ..., first + count - 1`` and ``pad`` neighbours on both sides.

    Edge values are repeated at the ends of the recording. ``acceleration_codes`` (count,) are the
    accelerometer as it is stored, where it was read.
    """

    first: int
    count: int
    channels: dict[str, Volts]
    pad: int = PAD
    acceleration_codes: npt.NDArray[Any] | None = None

    @property
    def last(self) -> int:
        """One past the last sample."""
        return self.first + self.count

    def trim(self, x: Volts) -> Volts:
        """``x`` (count + 2 pad,) without the neighbours."""
        return x[self.pad : self.pad + self.count]

    def thinned(self, width: int) -> Piece:
        """Means over ``width`` samples each, counted likewise; ``width`` divides ``first`` and ``pad``."""
        means = {name: block_means(x, width) for name, x in self.channels.items()}
        return Piece(self.first // width, self.count // width, means, self.pad // width)

    def own(self, channel: str) -> Volts:
        """Samples of a channel without the neighbours."""
        return self.trim(self.channels[channel])


@dataclass(frozen=True)
class Room:
    """Memory for one piece after the other: the codes as they are stored, and the volts, of each channel."""

    codes: dict[str, npt.NDArray[Any]]
    volts: dict[str, Volts]

    @classmethod
    def of(cls, recording: Recording, channels: tuple[str, ...], count: int) -> Self:
        """For pieces of ``count`` samples at most."""
        size = count + 2 * PAD
        codes = {name: np.empty(size, recording.codes(name, 0, 0).dtype) for name in channels}
        return cls(codes, {name: np.empty(size, dtype=np.float32) for name in channels})


def read_piece(
    recording: Recording, channels: tuple[str, ...], first: int, count: int, room: Room | None = None
) -> Piece:
    """Read one piece of the named channels, into ``room`` where it is given."""
    start, stop = max(first - PAD, 0), min(first + count + PAD, recording.n_samples)
    volts, stored = {}, None
    room = Room.of(recording, channels, count) if room is None else room
    for channel in channels:
        factor, offset = recording.scale(channel)
        codes = recording.codes(channel, start, stop, room.codes[channel])
        own = room.volts[channel][: count + 2 * PAD]
        at = start - (first - PAD)
        middle = own[at : at + codes.size]
        _volts(codes, np.float32(factor), np.float32(offset), middle)
        own[:at] = middle[0]
        own[at + codes.size :] = middle[-1]
        volts[channel] = own
        if channel == "accelerometer":
            stored = codes[first - start : first - start + count]
    return Piece(first, count, volts, acceleration_codes=stored)


def pieces(recording: Recording, channels: tuple[str, ...]) -> Iterator[Piece]:
    """All pieces of a recording, in order, each in the memory of the one before: what is needed of it is copied."""
    room = Room.of(recording, channels, min(PIECE, recording.n_samples))
    for first in range(0, recording.n_samples, PIECE):
        yield read_piece(recording, channels, first, min(PIECE, recording.n_samples - first), room)


def survey_pieces(recording: Recording, channels: tuple[str, ...]) -> Iterator[Piece]:
    """A few pieces spread over the recording (all of it where it is short)."""
    n = recording.n_samples
    if n <= SURVEY_PIECES * SURVEY_PIECE:
        for first in range(0, n, SURVEY_PIECE):
            yield read_piece(recording, channels, first, min(SURVEY_PIECE, n - first))
        return
    for k in range(SURVEY_PIECES):
        first = (n - SURVEY_PIECE) * k // (SURVEY_PIECES - 1)
        yield read_piece(recording, channels, first - first % PAD, SURVEY_PIECE)


def block_means(x: Volts, width: int, skip: int = 0) -> npt.NDArray[np.float32]:
    """Means over successive blocks of ``width`` samples after the first ``skip``; a remainder is left out."""
    out = np.empty(max(x.size - skip, 0) // width, dtype=np.float32)
    _means(x, width, skip, out)
    return out


@njit(fastmath=True, error_model="numpy")
def _means(x, width, skip, out):  # type: ignore[no-untyped-def]
    scale, fours = np.float32(1.0 / width), width // 4 * 4
    for i in range(out.shape[0]):
        a = b = c = d = np.float32(0.0)
        at = np.uint64(skip + i * width)  # unsigned: signed indices may count from the end, and are not vectorised
        for k in range(0, fours, 4):
            place = at + np.uint64(k)
            a += x[place]
            b += x[place + np.uint64(1)]
            c += x[place + np.uint64(2)]
            d += x[place + np.uint64(3)]
        for k in range(fours, width):
            a += x[at + np.uint64(k)]
        out[i] = ((a + b) + (c + d)) * scale


@njit(fastmath=True, error_model="numpy")
def _volts(codes, factor, offset, out):  # type: ignore[no-untyped-def]
    for i in range(codes.shape[0]):
        out[i] = codes[i] * factor + offset
