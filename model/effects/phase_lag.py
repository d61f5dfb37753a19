"""The plate follows the drive later than declared.
The rule kept here: a pure delay, so the phase grows with the frequency.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="phase_lag",
    summary="the plate follows the drive later than declared",
    parameters=(
        Parameter("delay_s", "s", -0.02, 0.02, 1e-4, calibration=1e-5, meaning="of the plate behind the drive"),
    ),
    seen_in=("plate",),
    confused_with={"contact_latency": "landing times"},
    reference="amplifier, shaker above its resonance",
)


def transfer(
    p: Mapping[str, float], omega_radps: NDArray[np.float64], accel_g: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Factor on drive -> plate."""
    return np.asarray(np.exp(-1j * omega_radps * p["delay_s"]))
