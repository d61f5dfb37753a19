"""Remarks on an import: missing channels, uneven times, implausible rates and ranges.

A remark states a finding and its meaning; it changes nothing. What contradicts the profile is a doubt
(`daq.instrument`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from daq.importers.timebase import JITTER_SHARE, Timebase
from daq.setup.setup import Setup

FEW = 5  # most pauses that are listed one by one
OTHER_RATE = 0.02  # relative deviation of a rate or frequency that is reported
OVER_RANGE = 1.05  # reading over range_v that is reported


def remarks(
    base: Timebase, steps: NDArray[np.void], channels: list[str], *, from_drive: bool, timed: bool
) -> list[str]:
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
    if len(base.gaps) and not timed:
        said.append("rows are missing where the forcing's phase jumps; whole cycles more may be missing there")
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
