"""The accelerometer reads too much (or too little).

The plate moves less than it seems, and flights know the truth.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Floats
from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="accelerometer_gain",
    summary="the accelerometer's sensitivity is not the declared one",
    parameters=(
        Parameter(
            "relative", "1", -0.5, 1.0, 0.01, calibration=0.005, stated_by="accelerometer.sensitivity",
            calibrated_by={"flip test": 1e-3}, drifts=True, meaning="reading over truth, minus 1",
        ),
    ),
    confused_with={"drive_gain": "landing times", "local_gravity": "an absolute scale: flip test"},
    reference="calibration, mounting",
)  # fmt: skip


def accelerometer_response(p: Mapping[str, float], omega_radps: Floats) -> Floats:
    """Reading over truth."""
    return np.full(np.shape(omega_radps), 1.0 + p["relative"])
