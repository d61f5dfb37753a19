"""The plate by the accelerometer while a run lasts: its motion, and the samples that impacts spoil.

Impacts ring far above the forcing and are not the plate's motion. They are filtered out of the
peaks, and the samples they spoil are marked, so that no limit trips on them and no tone is measured through them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.setup.setup import Setup
from kernels import njit
from kernels.arrays import Bools, Floats

IMPACT_SIGMAS = 6.5  # a jump from sample to sample, over the usual one, that only an impact makes

_FIELDS = 11


@dataclass(frozen=True)
class Motion:
    """The plate over one block."""

    acceleration_mps2: float  # peak from rest, impacts filtered out
    velocity_mps: float  # the same
    displacement_m: float  # the same
    square_sum: float  # sum of the squared acceleration over the block's samples
    since_impact: int  # samples since the last impact
    quiet: Bools  # where no impact rings, shape (n,)


class MotionWatch:
    """Follow the accelerometer from block to block.

    ``mps2_per_code`` is the signed scale of the accelerometer's codes.
    """

    def __init__(self, setup: Setup, mps2_per_code: float) -> None:
        rate_hz, first_hz = setup.sampling.rate_hz, setup.forcing.frequency_hz
        highest_hz = first_hz * setup.forcing.multiples[-1]
        # impacts ring above four times the fastest tone; offset and integrals forget below a twentieth of the first
        low = 1.0 - math.exp(-2.0 * math.pi * 4.0 * highest_hz / rate_hz)
        leak = 1.0 - math.exp(-2.0 * math.pi * 0.05 * first_hz / rate_hz)
        # the jumps are averaged over half a millisecond to see whether it still rings
        fast = 1.0 - math.exp(-1.0 / (5e-4 * rate_hz))
        self._constants = np.array([1.0 / rate_hz, low, leak, max(1.0, 1e-3 * rate_hz), fast])
        self._scale = mps2_per_code
        self._eighth = max(2, round(rate_hz / first_hz / 8))
        self._cycle = np.zeros(max(2, round(rate_hz / first_hz)), np.int16)  # the last one
        self._state = np.zeros(_FIELDS)
        self._started = False
        nothing, nowhere = np.zeros(1, np.int16), np.zeros(1, np.bool_)
        _follow(nothing, 1.0, nowhere, self._constants, np.zeros(_FIELDS), nowhere.copy())  # compiled before all moves

    def update(self, codes: NDArray[np.int16], landed: Bools | None = None, lost: int = 0) -> Motion:
        """The plate over the block with these accelerometer ``codes`` (n,).

        ``landed`` (n,) marks where the contact circuit closed: such an impact may ring too softly to detect. ``lost``
        samples are missing before it: the plate is taken to have moved as it did a cycle earlier, since a hole in the
        acceleration would be a jump of the velocity that nothing made.
        """
        codes = np.ascontiguousarray(codes)
        landed = np.zeros(codes.size, np.bool_) if landed is None else landed
        if not self._started and codes.size >= 2:
            self._started = True
            self._start(np.asarray(codes[: self._eighth], np.float64) * self._scale)
        if lost and self._started:  # by the last cycle; whole cycles of it change nothing
            n = lost % len(self._cycle)
            nowhere = np.zeros(n, np.bool_)
            _follow(self._cycle[:n].copy(), self._scale, nowhere, self._constants, self._state, nowhere.copy())
            self._state[7] += lost - n
            self._cycle = np.roll(self._cycle, -n)
        quiet = np.ones(codes.size, np.bool_)
        a, v, x, squares = _follow(codes, self._scale, landed, self._constants, self._state, quiet)
        self._cycle = np.concatenate([self._cycle, codes])[-len(self._cycle) :]
        return Motion(a, v, x, squares, max(0, int(self._state[7])), quiet)

    def _start(self, a_mps2: Floats) -> None:
        """Rest is where the run starts: an offset, or gravity, is not motion."""
        self._state[0] = np.mean(a_mps2)
        self._state[5] = a_mps2[0]
        self._state[6] = max(float(np.mean(np.square(np.diff(a_mps2)))), self._scale**2)
        self._state[7] = self._state[10] = self._constants[3]
        self._state[8] = self._state[6]


@njit()
def _follow(
    codes: NDArray[np.int16], scale: float, landed: Bools, constants: Floats, state: Floats, quiet: Bools
) -> tuple[float, float, float, float]:
    """Peaks of acceleration, velocity, displacement, and the sum of squares; marks ``quiet``.

    ``state``: rest, two low-passes, velocity, displacement, last sample, usual square of a jump, samples since impact,
    present mean square of the jumps, mean jump, samples since it was last loud.
    """
    dt, low, leak, ringing, fast = constants
    rise = int(1.0 / fast)  # samples of this block; those of the block before, if any, are gone
    rest, first, second, v, x, last, usual, since, present, slope, calm = state
    peak_a = peak_v = peak_x = squares = 0.0
    for i in range(codes.size):
        a = codes[i] * scale
        rest += leak * (a - rest)
        first += low * (a - rest - first)
        second += low * (first - second)
        # leaking integrals: of a true one any offset would grow without bound
        v += second * dt - leak * v
        x += v * dt - leak * x
        peak_a, peak_v, peak_x = max(peak_a, abs(second)), max(peak_v, abs(v)), max(peak_x, abs(x))
        squares += second * second
        slope += fast * (a - last - slope)  # the motion's own part of a jump
        jump = (a - last - slope) * (a - last - slope)
        since = 0.0 if jump > IMPACT_SIGMAS * IMPACT_SIGMAS * usual else since + 1.0
        present += fast * (jump - present)
        if landed[i]:
            since = -ringing  # undetected, it is waited for twice as long
        # ringing squares the jumps: four times the usual mean square is not noise
        loud = since <= 0.0 or present > 4.0 * usual
        calm = 0.0 if loud else calm + 1.0
        quiet[i] = since >= ringing and calm >= rise
        if calm == 0.0:  # ringing before it was detected
            quiet[max(0, i - rise) : i] = False
        cap = 9.0 if quiet[i] else 1.5  # ringing is not usual, but what never ends must be
        usual = max(usual + leak * (min(jump, cap * usual) - usual), scale * scale)  # a code is the least noise
        last = a
    for k, value in enumerate((rest, first, second, v, x, last, usual, since, present, slope, calm)):
        state[k] = value  # not state[:] = (...), for whose error message numba compiles text formatting for seconds
    return peak_a, peak_v, peak_x, squares
