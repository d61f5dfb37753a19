"""Plausibility of an import: remarks on what is odd, and refusals of sample rates that no recording can have.

A remark states a finding and its meaning; it changes nothing. A file is refused where going on would give wrong numbers
without a word. What contradicts the profile is a doubt (`daq.instrument`). Decision 113.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.columns import TIME_UNITS_S, Column
from daq.importers.timebase import JITTER_SHARE, Timebase, Times
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats

OTHER_RATE = 0.02  # relative deviation of a rate or frequency that is reported
MIXED = 1.05  # ratio of the fastest to the slowest part of a file beyond which no one rate describes it


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
            f"times are not even and are stored as they came; the analysis counts samples at {base.rate_hz:.6g} "
            f"samples/s, from which they differ by {base.jitter_s * 1e6:.3g} us rms"
        )
    if len(base.gaps) <= 5:  # few enough to be listed one by one
        said += [f"a pause before sample {at}: {lost} samples missing (+-{sigma})" for at, lost, sigma in base.gaps]
    else:
        first, longest = base.gaps[0], base.gaps[np.argmax(base.gaps[:, 1])]
        said.append(
            f"{len(base.gaps)} pauses, {base.gaps[:, 1].sum()} samples missing in all; the first before sample "
            f"{first[0]}, the longest ({longest[1]} samples, +-{longest[2]}) before sample {longest[0]}; --json lists "
            "them"
        )
    if len(base.gaps) and not timed:
        said.append("rows are missing where the forcing's phase jumps; whole cycles more may be missing there")
    if not len(steps):
        said.append("no steps were found: nothing holds still within a factor of 8 of the profile's frequency")
    return said


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
    """Channels that read more than their range by a twentieth."""
    described = {role: setup.channels.get(role) for role in peak_v}
    return [
        f"the {role} reads up to {peak:.4g} V; profile {setup.name!r} says range_v = {channel.range_v:g}"
        for role, peak in peak_v.items()
        if (channel := described[role]) is not None and peak > 1.05 * channel.range_v
    ]


def refuse_other_unit(path: Path, time: Column, rate_hz: float, setup: Setup) -> None:
    """Refuse times in another unit: a rate that is the profile's by a power of a thousand (raises InputError)."""
    if not setup.sampling.stated:
        return
    ratio = rate_hz / setup.sampling.rate_hz
    for other in (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9):
        if abs(ratio / other - 1.0) < OTHER_RATE:
            unit_s = TIME_UNITS_S[time.unit or "s"] * other
            right = next((name for name, size in TIME_UNITS_S.items() if abs(size / unit_s - 1.0) < 1e-9), "")
            said = f"is it in {right} (--map time={time.name}:{right})" if right else "is its unit right"
            raise InputError(
                f"{path}: column {time.name} in {time.unit or 's'} gives {rate_hz:.6g} samples/s, profile "
                f"{setup.name!r} says {setup.sampling.rate_hz:.6g}; {said}? If not, correct sampling.rate_hz."
            )


def refuse_mixed_rates(path: Path, times: Times, n: int, quantum_s: float) -> None:
    """Refuse a file whose parts were sampled at different rates.

    Raises `InputError` with the two rates, and the row near which they meet.

    The ``n`` times (at least 2) are seconds that do not fall; ``quantum_s`` is the rounding step of the column.
    """
    parts = min(32, n // 16)
    if parts < 2:
        return
    edges = np.linspace(0, n, parts + 1).astype(np.int64).tolist()
    # a median lies between the extremes: where these are alike everywhere, none has to be found
    ends = [_steps(times, a, b, quantum_s) for a, b in pairwise(edges)]
    spans = np.array([(own.min(), own.max()) for own in ends])
    if 0.0 < spans.max() < MIXED * spans.min():
        return
    steps = np.array([np.median(own) for own in ends])
    slowest, fastest = float(steps.max()), float(steps.min())
    if fastest <= 0.0 or slowest < MIXED * fastest:
        return
    middle = np.sqrt(slowest * fastest)
    change = 1 + int(np.argmax((steps[1:] > middle) != (steps[:-1] > middle)))
    raise InputError(
        f"{path}: sampled at mixed rates: {1.0 / steps[change - 1]:.6g} samples/s before row {edges[change]} or so, "
        f"{1.0 / steps[change]:.6g} after; wanted one rate: import each part from a file of its own."
    )


def _steps(times: Times, start: int, stop: int, quantum_s: float) -> Floats:
    """Seconds between samples, by strides long enough that rounding does not bias them."""
    own = times(start, min(stop, start + (1 << 16)))
    mean_s = float(own[-1] - own[0]) / (len(own) - 1)
    # fifty rounding steps long: a median of shorter ones would be a multiple of the rounding
    stride = max(int(min(np.ceil(50.0 * quantum_s / max(mean_s, 1e-12)), len(own) // 4)), 1)
    return np.asarray((own[stride:] - own[:-stride]) / stride)
