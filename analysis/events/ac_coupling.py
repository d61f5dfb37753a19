"""Contact voltage behind a coupling capacitor: measurement of the high-pass, and restoration of the levels.

Behind a high-pass with time constant ``T`` the level is ``x = y + l``. Here ``y`` is the recorded voltage, and ``l``
the low-passed level held by the capacitor: ``T dl/dt = x - l``. As ``x`` has two values, a signed edge decides which,
and ``l`` follows without integrating the noise. Thresholds, RC shapes and short contacts then work as behind a wire.
Edges must alternate: two successive edges of the same sign mean a missed edge; it is counted, and the level is reset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.events.levels import Levels
from analysis.signals import PAD, Piece
from daq.instrument.channel_limits import measure_noise
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

Volts = npt.NDArray[np.float32]

RISE_S = 2e-4  # longest rise of an edge
ISOLATED_S = 1.2e-3  # distance from other edges of an edge that is measured
MIN_EDGES = 8
USUAL_CORNER_HZ = 5.0  # corner assumed where no edge shows it
NEAR_LEVEL = 0.25  # distance from the level, as a fraction of the swing, beyond which an edge is under way


@dataclass(frozen=True)
class Coupling:
    """High-pass before the converter, measured on the recording."""

    levels: Levels  # closed at 0 V, open at the height of an edge, and the noise
    corner_hz: float
    edges: int  # edges measured; below `MIN_EDGES` the declared swing and `USUAL_CORNER_HZ` stand


def measure_coupling(pieces: Sequence[Floats], swing_v: float, rate_hz: float) -> Coupling:
    """Height of the edges, corner and noise from unbroken pieces of continuity volts.

    Parameters
    ----------
    pieces
        Volts, each shape (n,).
    swing_v
        Declared ``open_v - closed_v``; negative where open is the lower level.
    rate_hz
        Sampling rate.
    """
    found = [_edges(y, swing_v, rate_hz) for y in pieces]
    corner_hz = _corner_hz(pieces, found, rate_hz)
    decay = 2.0 * np.pi * (corner_hz or USUAL_CORNER_HZ) / rate_hz
    heights = np.concatenate([_heights(y, at, decay, rate_hz) for y, at in zip(pieces, found, strict=True)])
    noise = measure_noise(pieces, [_calm(y.size, at, rate_hz) for y, at in zip(pieces, found, strict=True)], rate_hz)
    noise_v = max(0.0 if noise is None else noise.rms_v, 1e-6 * abs(swing_v))
    if heights.size < MIN_EDGES or corner_hz is None:
        return Coupling(Levels(0.0, swing_v, noise_v), USUAL_CORNER_HZ, heights.size)
    height_v = float(np.copysign(np.median(np.abs(heights)), swing_v))
    return Coupling(Levels(0.0, height_v, noise_v), corner_hz, heights.size)


def _samples(seconds: float, rate_hz: float) -> int:
    """Duration in samples, at least two."""
    return max(2, round(seconds * rate_hz))


def _edges(y: Floats, swing_v: float, rate_hz: float) -> Integers:
    """Samples in the middle of an edge: local extremes of its rise over `RISE_S`."""
    step = _samples(RISE_S, rate_hz)
    if y.size < 8 * step:
        return np.zeros(0, np.int64)
    rise = np.abs(y[step:] - y[:-step])
    # noise and droop never rise by 0.4 of the declared swing within so short a time
    at = np.flatnonzero(rise > 0.4 * abs(swing_v))
    groups = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if at.size else []
    return np.array([int(g[np.argmax(rise[g])]) + step // 2 for g in groups], np.int64)


def _calm(size: int, at: Integers, rate_hz: float) -> Bools:
    """Samples of a piece that are far from its edges."""
    calm, around = np.ones(size, dtype=np.bool_), _samples(ISOLATED_S, rate_hz)
    for edge in at:
        calm[max(edge - around, 0) : edge + around] = False
    return calm


def _heights(y: Floats, at: Integers, decay: float, rate_hz: float) -> Floats:
    """Signed heights of the isolated edges, corrected for the droop on both sides."""
    # without another edge on both sides the means before and after belong to this edge
    step, around = _samples(RISE_S, rate_hz), _samples(ISOLATED_S, rate_hz)
    far = np.diff(np.concatenate([[0], at, [y.size]])) > around
    isolated = at[far[:-1] & far[1:]]
    span = np.arange(around - 2 * step)
    middle = step + 0.5 * (span.size - 1)
    after, before = (y[isolated[:, None] + sign * (step + span)].mean(axis=1) for sign in (1, -1))
    return np.asarray(after * np.exp(decay * middle) - before * np.exp(-decay * middle))


def _corner_hz(pieces: Sequence[Floats], found: Sequence[Integers], rate_hz: float) -> float | None:
    """Corner frequency from the decay of chunk means without an edge.

    The chunk before is the instrumental variable, so noise does not bias the estimate.
    """
    top = bottom = 0.0
    # means over 0.4 ms: short against the droop's time constant, long against the noise
    chunks, chunk = 0, _samples(4e-4, rate_hz)
    for y, at in zip(pieces, found, strict=True):
        n = y.size // chunk
        means = y[: n * chunk].reshape(n, chunk).mean(axis=1)
        free = np.ones(n, np.bool_)
        for shift in (-chunk, 0, chunk):
            free[np.clip((at + shift) // chunk, 0, max(n - 1, 0))] = False
        whole = free[:-2] & free[1:-1] & free[2:]
        old, now, new = means[:-2][whole], means[1:-1][whole], means[2:][whole]
        top, bottom, chunks = top + float(old @ new), bottom + float(old @ now), chunks + int(whole.sum())
    # fewer than 100 triples of chunks leave the decay unknown
    if chunks < 100 or not 0.0 < top < bottom:
        return None
    return float(-np.log(top / bottom)) * rate_hz / (2.0 * np.pi * chunk)


class LevelRestorer:
    """Restoration of successive pieces of drooping voltage to fractions of the swing: 0 closed, 1 open.

    Attributes
    ----------
    missed : list of int
        Samples at which an edge is known to have been missed since the one before.
    """

    def __init__(self, coupling: Coupling, rate_hz: float) -> None:
        self.missed: list[int] = []
        self._swing_v = coupling.levels.swing_v
        # a shorter overshoot than 0.15 ms is a spike, no edge
        self._rate_hz, self._persists = rate_hz, _samples(1.5e-4, rate_hz)
        # besides the capacitor's own leak the level follows what the model of one capacitor leaves, within 5 ms
        self._rates = np.array([1.0 - np.exp(-2.0 * np.pi * coupling.corner_hz / rate_hz), 1.0 / (5e-3 * rate_hz)])
        self._state = np.zeros(3)  # decided level, low-passed level, samples beyond a level
        self._before: Volts | None = None

    def restore(self, piece: Piece) -> Volts:
        """Fractions of the swing for channel ``continuity`` of a piece and its neighbours; pieces come in order."""
        volts, count = piece.channels["continuity"], piece.count
        fraction = (volts * np.float32(1.0 / self._swing_v)).astype(np.float32)
        if self._before is None:
            self._begin(fraction[PAD : PAD + count])
        missed = np.empty(count + PAD, np.int64)
        n = _restore(fraction[PAD : PAD + count], self._rates, self._persists, self._state, missed)
        self.missed += [piece.first + int(k) for k in missed[:n]]
        _restore(fraction[PAD + count :], self._rates, self._persists, self._state.copy(), missed)
        fraction[:PAD] = fraction[PAD] if self._before is None else self._before
        self._before = fraction[count : count + PAD].copy()
        return fraction

    def _begin(self, own: Volts) -> None:
        """Level at the start from the sign of the first edge: a rising edge begins closed."""
        edges, step = _edges(own.astype(np.float64), 1.0, self._rate_hz), _samples(RISE_S, self._rate_hz)
        falls = edges.size and own[min(edges[0] + step, own.size - 1)] < own[max(edges[0] - step, 0)]
        level = 1.0 if falls else 0.0
        self._state[:] = level, level - float(own[0]), 0.0


@njit(error_model="numpy")
def _restore(x, rates, persists, state, missed):  # type: ignore[no-untyped-def]
    """Restore the level in place; number of edges that were missed, their samples put in ``missed``."""
    leak, follow = rates
    level, held, beyond = state
    n = 0
    for i in range(x.shape[0]):
        value = x[i] + held
        off = value - level
        if off * (1.0 - 2.0 * level) > 0.5:
            level = 1.0 - level
            off = value - level
        # half a swing beyond the level is a second edge of the same sign, if it lasts: the one between was missed
        beyond = beyond + 1 if off * (1.0 - 2.0 * level) < -0.5 else 0
        if beyond == persists:
            held -= off
            value, off = level, 0.0
            missed[n] = i
            n += 1
            beyond = 0
        held += leak * (level - held)
        if abs(off) < NEAR_LEVEL:
            held -= follow * off
        x[i] = value
    state[0], state[1], state[2] = level, held, beyond
    return n
