"""The accelerometer shows the plate's motion late: by its filter, or because its channel is read later than others.

What passes a filter changes gain and phase together; a bare gain is `accelerometer_gain`. The contact circuit is
compared with a plate that has moved on, so that flights begin and end too early by it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="accelerometer_lag",
    summary="the accelerometer shows the plate's motion late",
    parameters=(
        Parameter("delay_s", "s", 0.0, 5e-3, 1e-5, start_grid=(1e-4, 1e-3), meaning="motion to reading"),
        Parameter(
            "low_pass_s", "s", 0.0, 0.02, 1e-5, start_grid=(1e-4, 1e-3), meaning="time constant of the sensor's filter",
        ),
        Parameter(
            "sharpness", "1", 0.0, 4.0, 0.5, start_grid=(0.0, 0.5, 1.0), is_shape=True,
            meaning="1 / (4 damping^2) of a filter of second order; 0: of first order",
        ),
        Parameter(
            "impact_s", "s", -5e-3, 5e-3, 1e-5, calibration=1e-3, hook="impact_delay_s",
            meaning="later an impact's mark than motion, where no edge tells it",
        ),
    ),
    variants=(("delay_s",), ("low_pass_s", "sharpness")),
    confused_with={"phase_lag": "landing times"},
    hides={("accelerometer_high_pass", "corner_hz"): (0.0, 0.02)},
    reference="bandwidth of the sensor, multiplexed sampling",
)  # fmt: skip


def accelerometer_response(p: Mapping[str, float], omega_radps: Floats) -> Complexes:
    """Reading over truth."""
    low = 1j * omega_radps * p["low_pass_s"]
    return np.asarray(np.exp(-1j * omega_radps * p["delay_s"]) / (1.0 + low + p["sharpness"] * low**2))
