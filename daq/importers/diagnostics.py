"""Remarks on an import: missing channels, uneven times, implausible rates, ranges, plate and contact circuit.

A remark states a finding and its meaning; it changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from daq.importers.timebase import JITTER_SHARE, Timebase
from daq.setup.setup import Setup
from daq.steps.forcing_detection import Read

Floats = NDArray[np.float64]
CONTACT_MOVES = 0.1  # part of the contact circuit's declared swing below which it does not change at all
GAMMAS = ("gamma", "achieved_gamma", "achieved_gamma_uncertainty")
FEW = 5  # most pauses that are listed one by one
OTHER_RATE = 0.02  # relative deviation of a rate or frequency that is reported
OVER_RANGE = 1.05  # reading over range_v that is reported
OTHER_SCALE = 1.5  # ratio of gamma at the plate to gamma commanded, up or down, that is reported
DEAD = 0.05  # ratio of the two gammas below which the accelerometer counts as dead
NOISE_SIGMAS = 4.0  # uncertainties within which gamma counts as zero
RESTING = 0.9  # peak of the plate's acceleration in g below which the ball certainly rests


def remarks(base: Timebase, steps: NDArray[np.void], channels: list[str], from_drive: bool) -> list[str]:
    """Remarks on channels, times, pauses and steps."""
    said = []
    if "continuity" not in channels:
        said.append("no continuity: only the plate can be analysed")
    if not from_drive:
        which = "no drive" if "drive" not in channels else "no steps in the drive"
        said.append(f"{which}: steps were looked for in the accelerometer, and gamma is the plate's")
    if not base.uniform and base.jitter_s * base.rate_hz > JITTER_SHARE:
        said.append(
            f"times are not even and are kept as they came; the analysis counts samples at {base.rate_hz:.6g} "
            f"samples/s, from which they differ by {base.jitter_s * 1e6:.3g} us rms"
        )
    said += _pauses(base)
    if not len(steps):
        said.append("no steps were found: nothing holds still within a factor of 8 of the profile's frequency")
    return said


def _pauses(base: Timebase) -> list[str]:
    """A few pauses one by one; many in one sentence."""
    if len(base.gaps) <= FEW:
        return [f"a pause before sample {at}: {lost} samples missing (+-{sigma})" for at, lost, sigma in base.gaps]
    first, longest = base.gaps[0], base.gaps[np.argmax(base.gaps[:, 1])]
    return [
        f"{len(base.gaps)} pauses, {base.gaps[:, 1].sum()} samples missing in all; the first before sample {first[0]}, "
        f"the longest ({longest[1]} samples, +-{longest[2]}) before sample {longest[0]}; --json lists them"
    ]


def rate_warnings(rate_hz: float, setup: Setup, steps: NDArray[np.void]) -> list[str]:
    """Deviations of sample rate and forcing frequency from the profile; ``setup`` as the profile has it."""
    said = []
    expected = setup.sampling.rate_hz
    if setup.sampling.stated and abs(rate_hz / expected - 1.0) > OTHER_RATE:
        said.append(
            f"{rate_hz:.6g} samples/s, where profile {setup.name!r} says {expected:.6g}: is the unit of time right?"
        )
    forcing_hz = setup.forcing.frequency_hz
    if rate_hz < 4.0 * forcing_hz * setup.forcing.ratio:
        said.append(
            f"{rate_hz:.6g} samples/s are too few for the profile's forcing at {forcing_hz:g} Hz: is the unit of time "
            "right (--map time=COLUMN:ms)?"
        )
    found = steps["frequency_hz"]
    if len(found) and (found.min() > (1.0 + OTHER_RATE) * forcing_hz or found.max() < (1.0 - OTHER_RATE) * forcing_hz):
        said.append(f"the steps are at {np.median(found):.5g} Hz, where profile {setup.name!r} says {forcing_hz:.5g}")
    return said


def range_warnings(peak_v: Mapping[str, float], setup: Setup) -> list[str]:
    """Channels that read more than their range."""
    said = []
    for role, peak in peak_v.items():
        range_v = getattr(setup.channels, role).range_v
        if peak > OVER_RANGE * range_v:
            said.append(f"the {role} reads up to {peak:.4g} V; profile {setup.name!r} says range_v = {range_v:g}")
    return said


def is_dead(achieved: Floats, sigma: Floats) -> bool:
    """Whether an accelerometer shows nothing of a motion: gamma of most steps within noise of zero."""
    return bool(len(achieved) and np.median(achieved - NOISE_SIGMAS * sigma) <= 0.0)


def plate_warnings(steps: NDArray[np.void], setup: Setup) -> list[str]:
    """Disagreements of drive and accelerometer: a dead accelerometer, exchanged channels, a wrong scale.

    Parameters
    ----------
    steps
        With the fields gamma (by the drive), achieved_gamma and achieved_gamma_uncertainty (by the accelerometer); NaN
        where unknown.
    setup
        Its scales tell exchanged channels from a wrong one.
    """
    commanded_gammas, achieved, sigma = (steps[name] for name in GAMMAS)
    measured = np.isfinite(achieved) & np.isfinite(sigma)
    if is_dead(achieved[measured], sigma[measured]):
        return ["the accelerometer shows nothing of the drive's motion: it is dead, unplugged, or another column"]
    known = measured & np.isfinite(commanded_gammas) & (commanded_gammas > 0.0)
    if not known.any() or setup.drive.g_per_volt is None:
        return []
    commanded, seen = float(np.median(commanded_gammas[known])), float(np.median(achieved[known]))
    ratio = float(np.median(achieved[known] / commanded_gammas[known]))
    if 1.0 / OTHER_SCALE < ratio < OTHER_SCALE:
        return []
    both = f"the drive asks for gamma {commanded:.3g}, the accelerometer shows {seen:.3g} (medians over the steps)"
    per_volt = setup.channels.accelerometer.volts_per_mps2 * setup.g_mps2.value * setup.drive.g_per_volt.value
    exchanged = ratio * per_volt**2  # ratio of the two gammas, were the channels exchanged
    if abs(np.log(max(exchanged, 1e-300))) < np.log(OTHER_SCALE):
        return [f"{both}; exchanged they would agree: are accelerometer and drive mapped the wrong way round?"]
    if ratio < DEAD:
        return [f"{both}: it is dead or unplugged, or its sensitivity is wrong by far"]
    return [f"{both}: is g_per_volt or the sensitivity wrong, or are two channels exchanged?"]


def contact_warnings(read: Read, setup: Setup, steps: NDArray[np.void]) -> list[str]:
    """Faults of the contact circuit: no change of level, or flight where the ball must rest."""
    circuit = setup.channels.continuity
    if circuit is None or circuit.coupling == "ac" or not len(steps):
        return []
    open_v, closed_v = circuit.open_v.value, circuit.closed_v.value
    most = sum(m * m * abs(z) for m, z in setup.forcing.displacement_tones())
    resting, low, high = [], np.inf, -np.inf
    for step in steps:
        a, b = int(step["first_sample"] + step["settle_samples"]), int(step["first_sample"] + step["n_samples"])
        volts = read(a, b)
        low, high = min(low, float(volts.min())), max(high, float(volts.max()))
        if np.fmax(step["achieved_gamma"], step["gamma"]) * most < RESTING:
            resting.append(float(np.mean(np.abs(volts - open_v) < np.abs(volts - closed_v))))
    declared = f"profile {setup.name!r} says open_v = {open_v:g}, closed_v = {closed_v:g}"
    if high - low < CONTACT_MOVES * abs(open_v - closed_v):
        return [f"the contact circuit stays between {low:.3g} and {high:.3g} V ({declared}): no flight can be seen"]
    if is_dead(steps["achieved_gamma"], steps["achieved_gamma_uncertainty"]):
        return []  # unknown when the ball rests
    if resting and np.median(resting) > 0.5:
        return [
            f"the contact circuit says flight while the plate moves by less than {RESTING:g} g, where the ball rests; "
            f"{declared}: are they exchanged?"
        ]
    return []
