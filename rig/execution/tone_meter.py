"""Complex amplitudes of the forcing's tones at the plate, from the accelerometer, window by window. Decision 52."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daq.loaded_tones import Load, LoadedTones
from daq.lock_in import LockIn
from daq.setup.setup import Setup
from kernels.arrays import Bools, Complexes, Floats
from rig.programme.forcing import PhaseClock

ENOUGH_WINDOWS = 3  # number of windows from which their scatter is a better uncertainty than the fits' own


@dataclass(frozen=True)
class Amplitudes:
    """Plate acceleration of each tone in m/s^2 (complex, phase from sample 0), with standard uncertainties."""

    values: Complexes
    uncertainty: Floats


@dataclass(frozen=True)
class MeterBlock:
    """A block for the meter: acceleration in m/s^2, mask without ringing, mask of the ball's contact.

    ``touching`` is None without a contact circuit.
    """

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

    Parameters
    ----------
    setup
        Forcing and rate.
    window_cycles
        Cycles of a window; the scatter from window to window is part of the uncertainty.

    Attributes
    ----------
    windows : list of Amplitudes
        The windows completed.
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
