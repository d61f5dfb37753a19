"""The plate by the accelerometer while a run lasts: its motion, its tones, and the samples that impacts spoil.

Impacts ring far above the forcing and are not the plate's motion. They are filtered out of the peaks, and the samples
they spoil are marked, so that no limit trips on them and no tone is measured through them. Tones are complex
amplitudes, window by window. Decision 52.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.loaded_tones import Load, LoadedTones
from daq.lock_in import LockIn
from daq.setup.setup import Setup
from kernels import njit
from kernels.arrays import Bools, Complexes, Floats
from rig.programme.ramp import PhaseClock

ENOUGH_WINDOWS = 3  # number of windows from which their scatter is a better uncertainty than the fits' own


@dataclass(frozen=True)
class Amplitudes:
    """Plate acceleration of each tone in m/s^2 (complex, phase from sample 0), with standard uncertainties."""

    values: Complexes
    uncertainty: Floats


@dataclass(frozen=True)
class MeterBlock:
    """A block: acceleration in m/s^2, mask without ringing, mask of contact (None without a circuit)."""

    first_sample: int
    acceleration_mps2: Floats
    quiet: Bools
    touching: Bools | None = None

    @property
    def end_sample(self) -> int:
        """The sample after its last."""
        return self.first_sample + len(self.acceleration_mps2)

    def cut(self, start: int, end: int) -> MeterBlock:
        """Its part in ``start <= sample < end``."""
        piece = slice(max(0, start - self.first_sample), max(0, end - self.first_sample))
        touching = None if self.touching is None else self.touching[piece]
        return MeterBlock(max(start, self.first_sample), self.acceleration_mps2[piece], self.quiet[piece], touching)


class ToneMeter:
    """Amplitudes of the forcing's tones from a chosen sample on, in windows of whole cycles.

    Ringing after impacts is masked, always at the same part of the cycle. Where the ball's load bends the plate, the
    masked part differs from the rest: so the load's part in the motion is fitted, too, and put back there.

    ``windows`` are those completed, of ``window_cycles`` each; the scatter from one to the next is part of the
    uncertainty.
    """

    def __init__(self, setup: Setup, window_cycles: int) -> None:
        self._clock = PhaseClock.of(setup.forcing.frequency_hz, setup.sampling.rate_hz)
        self._rate_hz, self._g_mps2 = setup.sampling.rate_hz, setup.g_mps2.value
        wanted = [multiple for multiple, _ in setup.forcing.displacement_tones()]
        # harmonics are fitted with the tones: a mask that follows the cycle would mix them in
        fitted = sorted({*range(1, 4), *wanted})
        self._frequencies_hz = [m * setup.forcing.frequency_hz for m in fitted]
        self._wanted = [fitted.index(m) for m in wanted]
        self._window_cycles = window_cycles
        self._load = Load()
        self.begin(0, 0)

    def begin(self, first_sample: int, end_sample: int | None = None) -> None:
        """Measure anew from ``first_sample`` (a cycle's first), to ``end_sample``; how the load acts stays known."""
        self._start, self._end = first_sample, end_sample
        self.windows: list[Amplitudes] = []
        self._total: LoadedTones | None = None
        self._open_window()

    def _open_window(self) -> None:
        """A new window from `_start` on."""
        cycle = self._clock.cycle_after(self._start)
        self._opened = self._start
        self._stop = self._clock.cycle_start(cycle + self._window_cycles)
        self._pieces: list[MeterBlock] = []

    def add(self, block: MeterBlock) -> None:
        """Take in a block."""
        end = block.end_sample if self._end is None else min(block.end_sample, self._end)
        while self._start < end and block.end_sample > self._start:
            piece = block.cut(self._start, min(self._stop, end))
            if len(piece.quiet):  # a loss may reach beyond the window
                self._pieces.append(piece)
            self._start = max(block.first_sample, min(self._stop, end))
            if self._start < self._stop:
                return
            # a window mostly under ringing would measure the ringing
            if sum(np.count_nonzero(one.quiet) for one in self._pieces) >= 0.3 * (self._stop - self._opened):
                window = self._sums()
                self._load = self._load + window.load()
                self.windows.append(self._of(window))
                self._total = window if self._total is None else self._total + window
            self._open_window()

    def _sums(self) -> LoadedTones:
        """Normal equations of the window, unmasked and masked samples and contact and flight separately."""
        sums = LockIn(self._rate_hz, self._frequencies_hz, sorts=4)
        for piece in self._pieces:
            touching = np.zeros(len(piece.quiet), np.bool_) if piece.touching is None else piece.touching
            sort = np.where(piece.quiet, 0, 2) + np.where(touching, 1, 0)
            sums.add(piece.acceleration_mps2, piece.first_sample, sort.astype(np.int8))
        return LoadedTones.of_sorts(sums, self._g_mps2)

    def _of(self, sums: LoadedTones) -> Amplitudes:
        """The wanted tones of a fit."""
        values, uncertainty = sums.solve(self._load)
        return Amplitudes(values[self._wanted], uncertainty[self._wanted])

    def estimate(self) -> Amplitudes | None:
        """Amplitudes by all samples so far, a window under way included from a cycle on; None before a whole cycle."""
        both = self._total
        if sum(np.count_nonzero(piece.quiet) for piece in self._pieces) * self._frequencies_hz[0] >= self._rate_hz:
            under_way = self._sums()
            both = under_way if both is None else both + under_way
        if both is None:
            return None
        whole = self._of(both)
        return replace(whole, uncertainty=_uncertainty(self.windows, whole.uncertainty))


def mean_of(windows: list[Amplitudes]) -> Amplitudes:
    """Mean of equally long measurements, with its uncertainty by `_uncertainty`."""
    values = np.mean([window.values for window in windows], axis=0)
    claimed = np.sqrt(np.sum([window.uncertainty**2 for window in windows], axis=0)) / len(windows)
    return Amplitudes(values, _uncertainty(windows, claimed))


def _uncertainty(windows: list[Amplitudes], claimed: Floats) -> Floats:
    """Standard uncertainty, of one quadrature, of the mean of ``windows``: by their scatter where they are enough.

    A fit's own uncertainty holds for white noise. Motion between the tones (ringing, a slow resonance, harmonics that
    were not fitted) makes it too large where it repeats from window to window, and too small where it does not. The
    fits' own value counts as one more window, so that few windows that agree by chance are not trusted too much.
    """
    if len(windows) < ENOUGH_WINDOWS:
        return claimed
    spread: Floats = np.std([window.values for window in windows], axis=0, ddof=1)
    degrees = 2.0 * (len(windows) - 1)  # two quadratures; Student's t of so many is wider than a normal by the root
    variance = (degrees * spread**2 / (2.0 * len(windows)) + 2.0 * claimed**2) / (degrees + 2.0)
    return np.asarray(np.sqrt(variance * (degrees + 2.0) / degrees))


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
    """Follow the accelerometer, of signed scale ``mps2_per_code``, from block to block."""

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
