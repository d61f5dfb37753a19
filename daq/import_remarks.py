"""What a person should know of an import: what is missing, uneven, or odd about the contact circuit.

The rule kept here: a remark says what was seen and what it means; it changes nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.coarse import Read
from daq.setup import Setup
from daq.timebase import JITTER_SHARE, Timebase

CONTACT_MOVES = 0.1  # of the declared swing of the contact circuit, below which it does not move at all
RESTING = 0.9  # of g, peak of the plate, at which the ball certainly rests


def remarks(base: Timebase, steps: NDArray[np.void], channels: list[str], from_drive: bool) -> list[str]:
    """What a person should know of an import."""
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
    for first, lost, sigma in base.gaps:
        said.append(f"a pause before sample {first}: {lost} samples missing (+-{sigma})")
    if not len(steps):
        said.append("no steps were found: nothing holds still within a factor of 8 of the profile's frequency")
    return said


def contact_doubts(read: Read, setup: Setup, steps: NDArray[np.void]) -> list[str]:
    """What is odd about the contact circuit: it never moves, or says flight where the ball cannot but rest."""
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
        if step["achieved_gamma"] * most < RESTING:
            resting.append(float(np.mean(np.abs(volts - open_v) < np.abs(volts - closed_v))))
    declared = f"profile {setup.name!r} says open_v = {open_v:g}, closed_v = {closed_v:g}"
    if high - low < CONTACT_MOVES * abs(open_v - closed_v):
        return [f"the contact circuit stays between {low:.3g} and {high:.3g} V ({declared}): no flight can be seen"]
    if resting and np.median(resting) > 0.5:
        return [
            f"the contact circuit says flight while the plate moves by less than {RESTING:g} g, where the ball rests; "
            f"{declared}: are they exchanged?"
        ]
    return []
