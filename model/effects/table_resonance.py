"""The table rings after each impact: a damped mode struck by the ball, on which the ball then rides and flies.

The impulse is ``mass_ratio (1 + e) v`` on the mode's velocity, downwards; a ball at rest also
presses it down by its weight, until it leaves.
"""

from __future__ import annotations

import math

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="table_resonance",
    summary="the table rings at a low frequency after each impact",
    parameters=(
        Parameter("mass_ratio", "1", 0.0, 1.0, 0.01, start_grid=(0.05,), meaning="ball over moving mass of the mode"),
        Parameter(
            "frequency_hz",
            "Hz",
            1.0,
            500.0,
            0.3,
            null_value=8.0,
            start_grid=tuple(3.0 * 1.13**k for k in range(22)),
            hint="slow_line_hz",
            is_shape=True,
            meaning="of the mode",
        ),
        Parameter(
            "damping",
            "1",
            0.0,
            0.9,
            0.02,
            null_value=0.05,
            start_grid=(0.05,),
            is_shape=True,
            meaning="damping over critical",
        ),
    ),
    confused_with={"amplitude_modulation": "the low-frequency line of the accelerometer"},
    reference="seed paper: a slow resonance of the whole shaker above gamma_peak 4",
)


@njit(error_model="numpy")
def plate_mode(p: Row, k: int) -> tuple[float, float, float]:
    """``(omega_radps, damping_ratio, mass_ratio)``."""
    return 2.0 * math.pi * p[k + 1], p[k + 2], p[k]
