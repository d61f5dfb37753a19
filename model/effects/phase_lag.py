"""The plate follows the drive otherwise than declared: later, or through a filter.

What passes changes gain and phase together, as a causal filter does; a bare gain is `drive_gain`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import ORDINARY_LAG, Effect, Parameter

EFFECT = Effect(
    name="phase_lag",
    summary="the plate follows the drive later than declared",
    parameters=(
        Parameter(
            "delay_s", "s", -0.02, 0.02, 1e-4, calibration=1e-5, stated_by="drive.phase_deg",
            meaning="of the plate behind the drive",
        ),
        Parameter(
            "low_pass_s", "s", 0.0, 0.02, 1e-4, start_grid=(1e-4, 1e-3),
            meaning="time constant of an amplifier's roll-off",
        ),
        Parameter(
            "high_pass_hz", "Hz", 0.0, 100.0, 0.1, start_grid=(0.1, 1.0), meaning="corner below which little passes",
        ),
        # to begin with: of first order; Butterworth; of damping 0.5
        Parameter(
            "sharpness", "1", 0.0, 4.0, 0.5, start_grid=(0.0, 0.5, 1.0), is_shape=True,
            meaning="1 / (4 damping^2) of a filter of second order; 0: of first order",
        ),
    ),
    variants=(("delay_s",), ("low_pass_s", "sharpness"), ("high_pass_hz", "sharpness")),
    confused_with={"contact_latency": "landing times", "drive_gain": "c = 1: two tones tell a filter from a gain"},
    hides=ORDINARY_LAG,
    reference="amplifier, shaker above its resonance",
)  # fmt: skip


def transfer(p: Mapping[str, float], omega_radps: Floats, accel_g: Floats) -> Complexes:
    """Factor on drive -> plate."""
    low = 1j * omega_radps * p["low_pass_s"]
    # a place that no tone uses has the frequency 0
    high = 2.0 * np.pi * p["high_pass_hz"] / (1j * np.maximum(omega_radps, 1e-3))
    filters = (1.0 + low + p["sharpness"] * low**2) * (1.0 + high + p["sharpness"] * high**2)
    return np.asarray(np.exp(-1j * omega_radps * p["delay_s"]) / filters)
