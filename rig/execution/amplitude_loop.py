"""Closed loop on gamma: each tone's complex amplitude at the plate, measured and driven to its target.

The rule kept here: settling is tested, not timed. A step may hold only when two measurements since the last change of
the drive put every tone within tolerance, their own uncertainty included. The estimator is the analysis' own
(`daq.lock_in`), impacts are masked, and nothing here does I/O.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.lock_in import LockIn
from daq.setup.setup import Setup
from rig.execution.plate_monitor import Mask
from rig.profile import ControlTable, Profile
from rig.programme.forcing import Complexes, Floats, PhaseClock, drive_amplitudes
from rig.programme.ramp import fade_cycles
from rig.programme.sequencer import Sequencer, State

HARMONICS = 3  # fitted beside the tones: a mask that follows the cycle would mix them in
COVERAGE = 2.5  # standard uncertainties kept between an estimate and its tolerance
SMALL_ERROR = 0.25  # of the tolerance: below, an error is left alone; above, it is corrected once it is certain
ENOUGH_WINDOWS = 3  # from so many windows on their scatter says more than what each claims of itself
OTHERWISE = 5.0  # spreads by which a window differs from those before only if the plate answers otherwise
SMALL_CORRECTION = 0.05  # a change of the drive over which the plate's response is one number
LARGEST_CORRECTION = 2.0  # factor by which one correction may change a tone
SIGNIFICANT = 5.0  # uncertainties by which the load's part must stand out
LEAST_QUIET = 0.3  # part of a window that impacts must leave, or it is dropped
DEAF = 0.1  # part of the target below which the accelerometer does not see the plate


@dataclass(frozen=True)
class Amplitudes:
    """Plate acceleration of each tone in m/s^2 (complex, phase from sample 0), with standard uncertainties."""

    values: Complexes
    uncertainty: Floats


@dataclass(frozen=True)
class MeterBlock:
    """A block as the meter takes it: acceleration in m/s^2, where no impact rings, where the ball touches the plate.

    ``touching`` is None where no contact circuit tells.
    """

    first_sample: int
    acceleration_mps2: Floats
    quiet: Mask
    touching: Mask | None = None

    @property
    def end_sample(self) -> int:
        """The sample after its last."""
        return self.first_sample + len(self.acceleration_mps2)

    def cut(self, start: int, end: int) -> MeterBlock:
        """What of it lies in ``start <= sample < end``."""
        piece = slice(max(0, start - self.first_sample), max(0, end - self.first_sample))
        touching = None if self.touching is None else self.touching[piece]
        return MeterBlock(max(start, self.first_sample), self.acceleration_mps2[piece], self.quiet[piece], touching)


class ToneMeter:
    """Amplitudes of the forcing's tones from a chosen sample on, in windows of whole cycles.

    What rings is left out, and always at the same part of the cycle: where the ball's load bends the plate, what is
    left out is not like the rest. So the load's part in the motion is fitted, too, and put back where it was left out.

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
        fitted = sorted({*range(1, HARMONICS + 1), *wanted})
        self._frequencies_hz = [m * setup.forcing.frequency_hz for m in fitted]
        self._wanted = [fitted.index(m) for m in wanted]
        self._window_cycles = window_cycles
        self._load = Load()
        self.begin(0, 0)

    def begin(self, first_sample: int, end_sample: int | None = None) -> None:
        """Measure anew from ``first_sample`` (a cycle's first), to ``end_sample``; how the load acts is kept."""
        self._start, self._end = first_sample, end_sample
        self.windows: list[Amplitudes] = []
        self._total: _Sums | None = None
        self._open_window()

    def _open_window(self) -> None:
        """A new window from `_start` on."""
        cycle = self._clock.cycle_after(self._start)
        self._opened = self._start
        self._stop = self._clock.cycle_start(cycle + self._window_cycles)
        self._pieces: list[MeterBlock] = []

    def add(self, heard: MeterBlock) -> None:
        """Take in a block."""
        end = heard.end_sample if self._end is None else min(heard.end_sample, self._end)
        while self._start < end and heard.end_sample > self._start:
            piece = heard.cut(self._start, min(self._stop, end))
            if len(piece.quiet):  # a loss may reach beyond the window
                self._pieces.append(piece)
            self._start = max(heard.first_sample, min(self._stop, end))
            if self._start < self._stop:
                return
            if sum(np.count_nonzero(one.quiet) for one in self._pieces) >= LEAST_QUIET * (self._stop - self._opened):
                window = self._sums()
                self._load = self._load + window.load()
                self.windows.append(self._of(window))
                self._total = window if self._total is None else self._total + window
            self._open_window()

    def _sums(self) -> _Sums:
        """The window's normal equations: acceleration, the ball's load as the plate's motion makes it, and both."""
        plain = LockIn(self._rate_hz, self._frequencies_hz)
        for piece in self._pieces:
            plain.add(piece.acceleration_mps2, piece.first_sample, piece.quiet)
        moved = plain.solve().amplitudes
        sums = LockIn(self._rate_hz, self._frequencies_hz, channels=3, sorts=2)
        for piece in self._pieces:
            load = np.zeros(len(piece.quiet))
            if piece.touching is not None:
                turns = np.outer(np.arange(piece.first_sample, piece.end_sample), self._frequencies_hz) / self._rate_hz
                motion = np.real(np.exp(2j * np.pi * (turns % 1.0)) @ moved)
                load = piece.touching * (motion + self._g_mps2)
            x = piece.acceleration_mps2
            sums.add(np.column_stack([x, load, x + load]), piece.first_sample, np.where(piece.quiet, 0, 1))
        return _Sums(sums.part([0]), sums.part([0, 1]))

    def _of(self, sums: _Sums) -> Amplitudes:
        """The wanted tones of a fit."""
        values, uncertainty = sums.solve(self._load)
        return Amplitudes(values[self._wanted], uncertainty[self._wanted])

    def estimate(self) -> Amplitudes | None:
        """What all samples so far say, a window under way included from a cycle on; None before a whole cycle."""
        both = self._total
        if sum(np.count_nonzero(piece.quiet) for piece in self._pieces) * self._frequencies_hz[0] >= self._rate_hz:
            under_way = self._sums()
            both = under_way if both is None else both + under_way
        if both is None:
            return None
        whole = self._of(both)
        return replace(whole, uncertainty=_uncertainty(self.windows, whole.uncertainty))


@dataclass(frozen=True)
class Load:
    """How the ball's load acts on the plate: sums, over samples, of what the tones leave of acceleration and load."""

    cross: float = 0.0
    load_square: float = 0.0
    square: float = 0.0
    n: int = 0

    def __add__(self, other: Load) -> Load:
        return Load(
            self.cross + other.cross, self.load_square + other.load_square, self.square + other.square, self.n + other.n
        )

    def share(self) -> tuple[float, float]:
        """Acceleration for a unit of load, and its standard uncertainty; nothing where it does not stand out."""
        if self.load_square <= 0.0:
            return 0.0, 0.0
        share = self.cross / self.load_square
        left = max(self.square - share * self.cross, 0.0)
        doubt = math.sqrt(left / (self.n * self.load_square))
        return (share, doubt) if abs(share) > SIGNIFICANT * doubt else (0.0, 0.0)


@dataclass(frozen=True)
class _Sums:
    """Normal equations of what does not ring, and of everything; channels: acceleration, load, their sum."""

    quiet: LockIn
    whole: LockIn

    def __add__(self, other: _Sums) -> _Sums:
        return _Sums(self.quiet + other.quiet, self.whole + other.whole)

    def load(self) -> Load:
        """What this piece says of the load's part in the motion."""
        x, load, both = (self.quiet.solve(channel) for channel in range(3))
        cross = 0.5 * (both.rms**2 - x.rms**2 - load.rms**2)
        return Load(cross * x.n, load.rms**2 * x.n, x.rms**2 * x.n, x.n)

    def solve(self, load: Load) -> tuple[Complexes, Floats]:
        """Amplitudes of all tones, of a motion that no mask has cut, and their standard uncertainties.

        With the acceleration ``x = tones + k load``, a masked fit gives ``tones + k (load's tones as the mask leaves
        them)``; ``k`` follows from what tones leave of both (Frisch and Waugh 1933).
        """
        x = self.quiet.solve(0)
        share, doubt = load.share()
        missing = self.whole.solve(1).amplitudes - self.quiet.solve(1).amplitudes
        return x.amplitudes + share * missing, np.hypot(x.amplitude_sigma(), np.abs(missing) * doubt / math.sqrt(2.0))


def mean_of(windows: list[Amplitudes]) -> Amplitudes:
    """Mean of equally long measurements, with its uncertainty by `_uncertainty`."""
    values = np.mean([window.values for window in windows], axis=0)
    claimed = np.sqrt(np.sum([window.uncertainty**2 for window in windows], axis=0)) / len(windows)
    return Amplitudes(values, _uncertainty(windows, claimed))


def _agrees(new: Amplitudes, before: list[Amplitudes]) -> bool:
    """Whether a measurement is like those before: a ball that takes up another motion loads the plate otherwise."""
    if len(before) < ENOUGH_WINDOWS:
        return True
    values = np.array([one.values for one in before])
    spread = np.maximum(np.std(values, axis=0, ddof=1), new.uncertainty)
    return bool(np.all(np.abs(new.values - values.mean(axis=0)) < OTHERWISE * spread))


def _uncertainty(windows: list[Amplitudes], claimed: Floats) -> Floats:
    """Standard uncertainty, of one quadrature, of the mean of ``windows``: by their scatter where they are enough.

    A fit claims what it would be in white noise; motion between the tones (ringing, a slow resonance, harmonics that
    were not fitted) makes that too much where it repeats from window to window, and too little where it does not. The
    claim counts as much as one more window, so that few windows that happen to agree are not believed too much.
    """
    if len(windows) < ENOUGH_WINDOWS:
        return claimed
    spread: Floats = np.std([window.values for window in windows], axis=0, ddof=1)
    degrees = 2.0 * (len(windows) - 1)  # two quadratures; Student's t of so many is wider than a normal by the root
    variance = (degrees * spread**2 / (2.0 * len(windows)) + 2.0 * claimed**2) / (degrees + 2.0)
    return np.asarray(np.sqrt(variance * (degrees + 2.0) / degrees))


def target_acceleration(setup: Setup, gamma: float) -> Complexes:
    """Plate acceleration of each tone at ``gamma``, complex m/s^2, phase from sample 0."""
    g = setup.g_mps2.value
    return np.array([-g * gamma * m * m * d for m, d in setup.forcing.displacement_tones()])


def achieved_gamma(setup: Setup, measured: Amplitudes) -> tuple[float, float]:
    """Gamma and its standard uncertainty from the first tone that is driven (scale and g included)."""
    unit = np.abs(target_acceleration(setup, 1.0))
    tone = int(np.argmax(unit > 0.0))
    gamma = float(np.abs(measured.values[tone]) / unit[tone])
    sensitivity, g = setup.channels.accelerometer.sensitivity, setup.g_mps2
    parts = (
        float(measured.uncertainty[tone] / unit[tone]),
        gamma * sensitivity.uncertainty / sensitivity.value,
        gamma * g.uncertainty / g.value,
    )
    return gamma, math.hypot(*parts)


class AmplitudeLoop:
    """Brings every step's tones to their target before it may hold.

    Parameters
    ----------
    profile
        With a ``[control]`` table.
    control
        That table.

    Attributes
    ----------
    worst : float
        Last judged error over tolerance, the largest of all tones in amplitude and phase; 1 is the edge.
    """

    def __init__(self, profile: Profile, control: ControlTable) -> None:
        self._profile, self._control = profile, control
        self._clock = PhaseClock.of(profile.forcing.frequency_hz, profile.sampling.rate_hz)
        unit = np.array(drive_amplitudes(profile, 1.0))
        # m/s^2 a volt of each tone, learnt anew in each step; a tone that is not driven keeps any value.
        target = target_acceleration(profile, 1.0)
        self._response = np.where(unit != 0.0, target / np.where(unit != 0.0, unit, 1.0), 1.0)
        self._meter = ToneMeter(profile, control.window_cycles)
        self._step = -1
        self._ratios: list[Amplitudes] = []
        self._since_change = 0
        self.worst = math.inf

    def amplitudes(self, gamma: float) -> tuple[complex, ...]:
        """Drive volts that should give ``gamma`` with the response as last measured."""
        return tuple((target_acceleration(self._profile, gamma) / self._response).tolist())

    def observe(self, heard: MeterBlock, sequencer: Sequencer) -> str | None:
        """Take in a block; while settling, retarget or settle ``sequencer``. Returns why it cannot, or None."""
        if sequencer.state is not State.SETTLING:
            return None
        if self._step != sequencer.step.index:
            self._step = sequencer.step.index
            self._ratios.clear()
            self._wait(sequencer.step.first_sample + sequencer.step.fade_samples)
        self._meter.add(heard)
        if len(self._meter.windows) > self._since_change:
            self._since_change += 1
            fault = self._judge(self._meter.windows[-1], sequencer)
            if fault is not None:
                return fault
        limit = self._control.max_cycles
        if self._clock.cycle_after(sequencer.position - sequencer.step.first_sample) > limit:
            return (
                f"step {sequencer.step.index} (gamma {sequencer.step.gamma:g}) has not settled within {limit} cycles: "
                f"{self.worst:.2g} times the tolerance; see [control], or the plate"
            )
        return None

    def _wait(self, sample: int) -> None:
        """Measure anew, some cycles after ``sample``."""
        cycle = self._clock.cycle_after(sample) + self._control.wait_cycles
        self._meter.begin(self._clock.cycle_start(cycle))
        self._since_change = 0

    def _judge(self, window: Amplitudes, sequencer: Sequencer) -> str | None:
        """Settle, correct, or go on measuring."""
        target = target_acceleration(self._profile, sequencer.step.gamma)
        driven = np.abs(target) > 0.0
        if not np.any(driven):  # gamma = 0: nothing to reach
            sequencer.settled()
            return None
        drive = np.array(sequencer.amplitudes)[driven]
        ratio = Amplitudes(window.values[driven] / drive, window.uncertainty[driven] / np.abs(drive))
        self._ratios = [*self._ratios, ratio] if _agrees(ratio, self._ratios) else [ratio]
        response = mean_of(self._ratios)
        error = response.values * drive / target[driven]
        if np.any(np.abs(error) < DEAF):
            seen = float(np.abs(error).min())
            return f"step {sequencer.step.index}: the accelerometer sees {seen:.2g} of the motion asked for"
        tolerances = self._control.tolerance, math.radians(self._control.tolerance_deg)
        doubt = COVERAGE * float(np.max(response.uncertainty / np.abs(response.values))) / min(tolerances)
        errors = np.abs(np.abs(error) - 1.0) / tolerances[0], np.abs(np.angle(error)) / tolerances[1]
        self.worst = float(np.max(errors))
        if min(self._since_change, len(self._ratios)) >= 2 and self.worst + doubt <= 1.0:
            sequencer.settled()
        elif self.worst > max(doubt, SMALL_ERROR):
            self._correct(sequencer, driven, error)
        return None

    def _correct(self, sequencer: Sequencer, driven: Mask, error: Complexes) -> None:
        """Divide each driven tone by its error, within the slew limit, and measure again."""
        before = np.array(sequencer.amplitudes)
        size = np.clip(np.abs(error), 1.0 / LARGEST_CORRECTION, LARGEST_CORRECTION)
        after = before.copy()
        after[driven] = before[driven] / (size * np.exp(1j * np.angle(error)))
        gamma = sequencer.step.gamma
        self._response[driven] = (target_acceleration(self._profile, gamma) / after)[driven]
        change = float(np.max(np.abs(after - before)[driven] / np.abs(before[driven])))
        if change > SMALL_CORRECTION:  # far away the plate may answer otherwise; near, what was measured still counts
            self._ratios.clear()
        self._wait(sequencer.retarget(tuple(after.tolist()), fade_cycles(self._profile.ramp, gamma * change)))
