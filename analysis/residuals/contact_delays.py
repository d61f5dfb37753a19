"""A contact circuit that opens later than it closes, as a comparator with hysteresis behind an RC does.

Such a circuit has two delays, which are no cause of the motion: they are measured here and taken off the edges. How
late it closes is what the accelerometer's impacts say; how late it opens, the plate's acceleration at take-offs from
rest. There a force or a wrong scale of either sensor moves an opening by an acceleration over the plate's jerk, and
only a delay by the same time in all. A circuit that shows both edges equally late is left to `contact_latency`.
Decision 586.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.events.sensor_offset import SensorOffset
from analysis.linear_algebra import pinv
from analysis.statistics import mad_sigma
from kernels.arrays import Bools, Floats, Integers
from model.integrator.problem import Measured, PlateSteps

MIN_OPENINGS = 40
MIN_STEPS = 4
LEAST_S = 1e-5  # difference of the two delays that is worth a word
SURE_SIGMAS = 5.0  # standard deviations from which the difference is believed
ALIKE = 1.5  # scatter of openings about one delay over their uncertainty, from which they have not one delay
ROUNDS = 20  # of the robust fit


@dataclass(frozen=True)
class ContactDelays:
    """By how much later than they happen closings and openings are seen."""

    closing_s: float
    opening_s: float

    def taken_off(self, measured: Measured, heard: Bools) -> Measured:
        """Flights as they happened; ``heard`` (n,): landings that only the accelerometer shows."""
        left_heard = measured.relaunched & np.append(False, heard[:-1])
        landing_s = measured.landing_s - self.closing_s
        opening_s = measured.opening_s - np.where(left_heard, self.closing_s, self.opening_s)
        opening_s[1:] = np.where(measured.linked[1:], np.maximum(opening_s[1:], landing_s[:-1]), opening_s[1:])
        return replace(measured, opening_s=opening_s, landing_s=landing_s)

    def in_words(self) -> str:
        """A remark for the report."""
        closes = f" and closes {1e6 * self.closing_s:.0f} us late" if self.closing_s else " late, its closings unknown"
        return (
            f"the contact circuit opens {1e6 * self.opening_s:.0f} us{closes}, as one with hysteresis does: taken off"
        )


def contact_delays(
    measured: Measured,
    from_rest: Bools,
    sigma_s: Floats,
    plate: PlateSteps,
    g_mps2: float,
    offset: SensorOffset,
    sharp: bool,
) -> ContactDelays | None:
    """The delays of a circuit that does not show both edges equally late; None for one that does, or may.

    Parameters
    ----------
    measured, from_rest, sigma_s
        Flights, which of them began from rest, and the uncertainty of their openings, (n,) each.
    plate
        Tones of the steps.
    g_mps2
        Local gravity.
    offset
        Accelerometer against closings. An accelerometer that is late itself does not tell when the circuit closes.
    sharp
        Whether the circuit changes from one sample to the next, so that an RC before a comparator is not seen. Where
        landings are heard only, such a circuit's closings are left as they are.
    """
    known = bool(np.isfinite(offset.uncertainty_s))
    # impacts that are read once a sample may all be early
    if offset.offset_s > 0.0 or offset.rounding_s > 0.0 or not (known or sharp):
        return None
    rows = np.flatnonzero(from_rest)
    step = measured.step[rows]
    # later by more than a tenth of a cycle is another event
    found = _common(measured.opening_s[rows], step, plate, g_mps2, 0.1 * plate.period_s[step])
    if found is None:
        return None
    delay_s, own_s, scatter_s = found
    sure_s = max(LEAST_S, SURE_SIGMAS * float(np.hypot(own_s, offset.uncertainty_s if known else 0.0)))
    if scatter_s > ALIKE * float(np.median(sigma_s[rows])) or delay_s + offset.offset_s < sure_s:
        return None
    return ContactDelays(-offset.offset_s if known else 0.0, delay_s)


def _common(
    opening_s: Floats, step: Integers, plate: PlateSteps, g_mps2: float, most_s: Floats
) -> tuple[float, float, float] | None:
    """The delay that openings (k,) share, its uncertainty, and their scatter about it; None where too few tell.

    A ball at rest leaves as the plate falls away faster than gravity and an unknown constant pull.
    """
    pull, delay = g_mps2, 0.0
    for _ in range(ROUNDS):
        left_s, jerk_mps3 = _leaves(opening_s - delay, step, plate, pull)
        late_s = opening_s - left_s
        usual = (jerk_mps3 > 0.0) & (np.abs(late_s - delay) < most_s)
        if usual.sum() < MIN_OPENINGS or len(np.unique(step[usual])) < MIN_STEPS:
            return None
        shapes = np.column_stack([np.ones(int(usual.sum())), 1.0 / jerk_mps3[usual]])
        left = late_s[usual] - delay
        scatter = max(mad_sigma(left), 1e-9)
        weight = 1.0 / np.maximum(1.0, np.abs(left) / (2.0 * scatter))
        covariance = pinv((shapes * weight[:, None]).T @ shapes)
        change = covariance @ (shapes.T @ (weight * left))
        delay, pull = delay + float(change[0]), pull + float(change[1])
    return delay, float(np.sqrt(covariance[0, 0])) * scatter, scatter


def _leaves(near_s: Floats, step: Integers, plate: PlateSteps, pull_mps2: float) -> tuple[Floats, Floats]:
    """When the plate falls away faster than a pull, near times (k,), and its jerk downward then."""
    turns, z = 1j * plate.omega_radps[step], plate.acceleration_mps2[step]
    left_s = near_s.copy()
    for _ in range(3):  # Newton's steps
        waves = z * np.exp(turns * left_s[:, None])
        jerk = np.sum(turns * waves, axis=1).real
        left_s = left_s - (np.sum(waves, axis=1).real + pull_mps2) / np.where(jerk == 0.0, np.inf, jerk)
    return left_s, -jerk
