"""Recordings read piece by piece, as float32 volts, in bounded memory; the search for samples that matter; a high-pass.

Pieces carry neighbouring samples on both sides for detectors that need the surroundings of an event.

Behind a coupling's high-pass of corner ``f`` an impact whose acceleration has the integral ``J`` leaves a tail
``-2 pi f J exp(-2 pi f t)``, which outlasts any mask. Restored, it ends with the impact: what is taken away then is the
whole impact, and the high-pass that is put back makes no tail of it. Tones and noise come out as they were recorded.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from scipy.signal import bilinear, detrend, lfilter

from daq.instrument.held_readings import RHYTHM_FRAME, held_samples, without_stair
from daq.recording import Recording
from kernels import njit
from kernels.arrays import Bools, Floats

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
    held: float  # samples for which the accelerometer holds each reading

    @classmethod
    def of(cls, recording: Recording, channels: tuple[str, ...], count: int) -> Self:
        """For pieces of ``count`` samples at most."""
        size, n = count + 2 * PAD, recording.n_samples
        codes = {name: np.empty(size, recording.codes(name, 0, 0).dtype) for name in channels}
        looked = [
            recording.codes("accelerometer", a, min(a + RHYTHM_FRAME + 1, n))
            for a in np.linspace(0, max(n - 2 * RHYTHM_FRAME, 0), 9).astype(int).tolist() if "accelerometer" in channels
        ]  # fmt: skip
        return cls(codes, {name: np.empty(size, dtype=np.float32) for name in channels}, held_samples(looked))


def read_piece(recording: Recording, first: int, count: int, room: Room) -> Piece:
    """Read one piece of the channels of ``room`` into it."""
    start, stop = max(first - PAD, 0), min(first + count + PAD, recording.n_samples)
    volts, stored = {}, None
    for channel in room.codes:
        factor, offset = recording.scale(channel)
        codes = recording.codes(channel, start, stop, room.codes[channel])
        own = room.volts[channel][: count + 2 * PAD]
        at = start - (first - PAD)
        middle = own[at : at + codes.size]
        _volts(codes, np.float32(factor), np.float32(offset), middle)
        if channel == "accelerometer":
            stored = codes[first - start : first - start + count]
            without_stair(middle, room.held)
        own[:at] = middle[0]
        own[at + codes.size :] = middle[-1]
        volts[channel] = own
    return Piece(first, count, volts, acceleration_codes=stored)


def pieces(recording: Recording, channels: tuple[str, ...]) -> Iterator[Piece]:
    """All pieces of a recording, in order, each in the memory of the one before: what is needed of it is copied."""
    room = Room.of(recording, channels, min(PIECE, recording.n_samples))
    for first in range(0, recording.n_samples, PIECE):
        yield read_piece(recording, first, min(PIECE, recording.n_samples - first), room)


def survey_pieces(recording: Recording, channels: tuple[str, ...]) -> Iterator[Piece]:
    """A few pieces spread over the recording (all of it where it is short)."""
    n = recording.n_samples
    firsts = list(range(0, n, SURVEY_PIECE))
    if n > SURVEY_PIECES * SURVEY_PIECE:
        firsts = [(n - SURVEY_PIECE) * k // (SURVEY_PIECES - 1) // PAD * PAD for k in range(SURVEY_PIECES)]
    room = Room.of(recording, channels, min(SURVEY_PIECE, n))
    for first in firsts:
        yield read_piece(recording, first, min(SURVEY_PIECE, n - first), deepcopy(room))


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


def near(these: Bools, before: int, after: int) -> Bools:
    """Which samples (n,) have one of ``these`` up to ``before`` samples after them, or ``after`` samples before."""
    counts = np.concatenate([np.zeros(after + 1, np.int64), np.cumsum(these), np.full(before, np.count_nonzero(these))])
    return np.asarray(counts[before + after + 1 :] > counts[: these.size])


@njit(error_model="numpy", fastmath={"contract", "nsz"})
def unpredicted(x, weights, known):  # type: ignore[no-untyped-def]
    """Sizes (n,) of the sums of each sample of ``x`` (n,) and those before it, weighted (k,); 0 where not ``known``."""
    out = np.zeros(x.size)
    for begin in range(0, x.size, 1024):
        own = out[begin : begin + 1024]
        for k in range(weights.size):
            skip = max(k - begin, 0)
            later, before = own[skip:], x[begin + skip - k :]
            for i in range(later.size):
                later[i] += weights[k] * before[i]
    for i in range(x.size):
        out[i] = abs(out[i]) if known[i] else 0.0
    return out


AT_ONCE = 64  # samples looked at together for whether any of them matters


@njit()
def first_beyond(x, begin, bound, above):  # type: ignore[no-untyped-def]
    """First place from ``begin`` on where ``x`` (n,) is above the bound, or else below it; n where it never is."""
    while begin < x.shape[0]:
        hits, end = np.int32(0), min(begin + AT_ONCE, x.shape[0])
        if end - begin == AT_ONCE:  # a number of turns that the compiler knows
            at = np.uint64(begin)
            if above:
                for k in range(AT_ONCE):
                    hits += np.int32(x[at + np.uint64(k)] > bound)
            else:
                for k in range(AT_ONCE):
                    hits += np.int32(x[at + np.uint64(k)] < bound)
        if hits or end - begin < AT_ONCE:
            for i in range(begin, end):
                if x[i] > bound if above else x[i] < bound:
                    return i
        begin = end
    return begin


LEAST_HZ = 1.0  # corner from which tails of impacts matter


def restored(acceleration: Floats, corner_hz: float, rate_hz: float) -> Floats:
    """Acceleration (n,) of a plate that goes nowhere, before a high-pass of first order, less a line."""
    own = acceleration - acceleration.mean()
    return np.asarray(detrend(own + 2.0 * np.pi * corner_hz / rate_hz * (np.cumsum(own) - 0.5 * own)))


class HighPass:
    """The high-pass of successive pieces of a recording.

    Parameters
    ----------
    corner_hz : float
        Of a high-pass of first order.
    rate_hz : float
    """

    def __init__(self, corner_hz: float, rate_hz: float) -> None:
        w = 2.0 * np.pi * corner_hz
        # below 5 % of the corner nothing is restored: noise and bias would grow without end
        b, a = bilinear([1.0, w], [1.0, 0.05 * w], fs=rate_hz)
        self._undo, self._redo = (b / a[0], a / a[0]), (a / b[0], b / b[0])
        self._undone, self._redone = np.zeros(1), np.zeros(1)
        self._before: Volts | None = None

    def undo(self, piece: Piece) -> None:
        """Restore channel ``accelerometer`` of a piece and its neighbours in place; pieces come in order."""
        volts, pad = piece.channels["accelerometer"], piece.pad
        if self._before is None:
            volts[:pad], self._undone = self._filtered(self._undo, volts[:pad], self._undone)
            self._redone = self._filtered(self._redo, volts[:pad], self._redone)[1]
        else:
            volts[:pad] = self._before
        own, self._undone = self._filtered(self._undo, piece.own("accelerometer"), self._undone)
        after, _ = self._filtered(self._undo, volts[pad + piece.count :], self._undone)
        volts[pad : pad + piece.count], volts[pad + piece.count :] = own, after
        self._before = volts[piece.count : piece.count + pad].copy()

    def redo(self, piece: Piece) -> None:
        """Put the high-pass back into a piece that `undo` restored, in place, its neighbours left out."""
        own, self._redone = self._filtered(self._redo, piece.own("accelerometer"), self._redone)
        piece.own("accelerometer")[:] = own

    @staticmethod
    def _filtered(of: tuple[Floats, Floats], volts: Volts, state: Floats) -> tuple[Floats, Floats]:
        out, state = lfilter(*of, volts.astype(np.float64), zi=state)
        return out, state
