"""The plate moves at multiples of the forcing that nobody asked for.
The rule kept here: amplitudes of acceleration relative to the first tone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="harmonic_distortion",
    summary="the plate also moves at multiples of the forcing frequency",
    parameters=(
        Parameter(
            "second", "1", 0.0, 1.0, 0.005, calibration=1e-4, power=0.5, meaning="second harmonic over first tone"
        ),
        Parameter("third", "1", 0.0, 1.0, 0.005, calibration=1e-4, power=0.5, meaning="third harmonic over first tone"),
    ),
    variants=(("second", "third"),),
    seen_in=("plate",),
    confused_with={"gain_compression": "amplitude of the first tone"},
    reference="non-linear suspension and amplifier",
)


def harmonics(p: Mapping[str, float]) -> NDArray[np.float64]:
    """Amplitude of the 2nd and 3rd harmonic relative to the first tone."""
    return np.array([p["second"], p["third"]])
