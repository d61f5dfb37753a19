"""Closed loop on gamma: each tone's complex amplitude at the plate, measured and driven to its target.

A step may hold only when two measurements since the last change of
the drive put every tone within tolerance, their own uncertainty included. The estimator is the analysis' own
(`daq.lock_in`), impacts are masked, and nothing here does I/O.
"""

from __future__ import annotations

import math

import numpy as np

from daq.setup.setup import Setup
from kernels.arrays import Bools, Complexes
from rig.execution.plate_monitor import ENOUGH_WINDOWS, Amplitudes, MeterBlock, ToneMeter, mean_of
from rig.profile import ControlTable, Profile
from rig.programme.ramp import PhaseClock, drive_amplitudes, fade_cycles
from rig.programme.sequencer import Sequencer, State

LARGEST_CORRECTION = 2.0  # factor by which one correction may change a tone


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

    ``worst`` is the last judged error over tolerance, the largest of all tones in amplitude and phase; 1 is the edge.
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

    def observe(self, block: MeterBlock, sequencer: Sequencer) -> str | None:
        """Take in a block; while settling, retarget or settle ``sequencer``. Returns why it cannot, or None."""
        if sequencer.state is not State.SETTLING:
            return None
        if self._step != sequencer.step.index:
            self._step = sequencer.step.index
            self._ratios.clear()
            self._wait(sequencer.step.first_sample + sequencer.step.fade_samples)
        self._meter.add(block)
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
        before = np.array([one.values for one in self._ratios])
        alike = True
        if len(before) >= ENOUGH_WINDOWS:
            spread = np.maximum(np.std(before, axis=0, ddof=1), ratio.uncertainty)
            # beyond five spreads the plate answers otherwise: the ball has taken up another motion and loads it anew
            alike = bool(np.all(np.abs(ratio.values - before.mean(axis=0)) < 5.0 * spread))
        self._ratios = [*self._ratios, ratio] if alike else [ratio]
        response = mean_of(self._ratios)
        error = response.values * drive / target[driven]
        # the accelerometer does not measure this plate: a correction would only turn the drive up
        if np.any(np.abs(error) < 0.1):
            seen = float(np.abs(error).min())
            return f"step {sequencer.step.index}: the accelerometer sees {seen:.2g} of the motion asked for"
        tolerances = self._control.tolerance, math.radians(self._control.tolerance_deg)
        # the estimate must lie within the tolerance by 2.5 of its standard uncertainties
        margin = 2.5 * float(np.max(response.uncertainty / np.abs(response.values))) / min(tolerances)
        errors = np.abs(np.abs(error) - 1.0) / tolerances[0], np.abs(np.angle(error)) / tolerances[1]
        self.worst = float(np.max(errors))
        if min(self._since_change, len(self._ratios)) >= 2 and self.worst + margin <= 1.0:
            sequencer.settled()
        # an error is corrected once it is certain, and small ones never: each correction costs a settling time
        elif self.worst > max(margin, 0.25):
            self._correct(sequencer, driven, error)
        return None

    def _correct(self, sequencer: Sequencer, driven: Bools, error: Complexes) -> None:
        """Divide each driven tone by its error, within the slew limit, and measure again."""
        before = np.array(sequencer.amplitudes)
        # a wild measurement must not throw the plate: at most a factor of two at once
        size = np.clip(np.abs(error), 1.0 / LARGEST_CORRECTION, LARGEST_CORRECTION)
        after = before.copy()
        after[driven] = before[driven] / (size * np.exp(1j * np.angle(error)))
        gamma = sequencer.step.gamma
        self._response[driven] = (target_acceleration(self._profile, gamma) / after)[driven]
        change = float(np.max(np.abs(after - before)[driven] / np.abs(before[driven])))
        # far away the plate may answer otherwise; near, what was measured still counts
        if change > 0.05:
            self._ratios.clear()
        self._wait(sequencer.retarget(tuple(after.tolist()), fade_cycles(self._profile.ramp, gamma * change)))
