"""Drive volts give more plate motion than declared.

The accelerometer reads the true motion, so flights do not notice.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="drive_gain",
    summary="a volt of drive moves the plate by more (or less) than declared",
    parameters=(
        Parameter(
            "relative", "1", -0.9, 5.0, 0.01, calibration=0.005, stated_by="drive.g_per_volt", drifts=True,
            meaning="true over declared, minus 1",
        ),
    ),
    confused_with={"accelerometer_gain": "landing times", "gain_compression": "a range of amplitudes"},
    reference="amplifier knob, shaker sensitivity",
)  # fmt: skip


def transfer(p: Mapping[str, float], omega_radps: Floats, accel_g: Floats) -> Complexes:
    """Factor on drive -> plate."""
    return np.full(omega_radps.shape, 1.0 + p["relative"], dtype=np.complex128)
