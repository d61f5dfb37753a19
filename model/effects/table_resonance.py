"""The table rings after each impact: a damped mode struck by the ball, on which the ball then rides and flies.

The impulse is ``mass_ratio (1 + e) v`` on the mode's velocity, downwards; a ball at rest also
presses it down by its weight and its inertia, until it leaves. The drive was scaled to the plate that the operator had
before him: bare, or loaded with the ball at rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="table_resonance",
    summary="the table rings at a low frequency after each impact",
    parameters=(
        Parameter("mass_ratio", "1", 0.0, 1.0, 0.01, start_grid=(0.05,), meaning="ball over moving mass of the mode"),
        Parameter(
            "frequency_hz", "Hz", 1.0, 500.0, 0.3, null_value=8.0, start_grid=tuple(3.0 * 1.13**k for k in range(22)),
            hint="slow_line_hz", is_shape=True, meaning="of the mode",
        ),
        Parameter(
            "damping", "1", 0.0, 0.9, 0.02, null_value=0.05, start_grid=(0.05, 0.3), is_shape=True,
            meaning="damping over critical",
        ),
        Parameter(
            "loaded", "1", 0.0, 1.0, 0.3, start_grid=(1.0,), is_shape=True, plate_only=True,
            meaning="1 where the drive was scaled with the ball at rest on the plate",
        ),
    ),
    variants=(("mass_ratio", "frequency_hz", "damping"), ("mass_ratio", "frequency_hz", "damping", "loaded")),
    confused_with={"amplitude_modulation": "the low-frequency line of the accelerometer"},
    reference="seed paper: a slow resonance of the whole shaker above gamma_peak 4",
)  # fmt: skip


@njit(error_model="numpy")
def plate_mode(p: Row, k: int) -> tuple[float, float, float]:
    """``(omega_radps, damping_ratio, mass_ratio)``."""
    return 2.0 * math.pi * p[k + 1], p[k + 2], p[k]


def transfer(p: Mapping[str, float], omega_radps: Any, accel_g: Any) -> Any:
    """Factor on the bare plate's tones, where the drive's scale is that of the plate under the ball."""
    own = 2.0 * np.pi * p["frequency_hz"]
    # a mode that nothing damps has no steady answer at its own frequency
    bare = own**2 - omega_radps**2 + 2j * max(p["damping"], 1e-6) * own * omega_radps
    return 1.0 - p["loaded"] * p["mass_ratio"] * omega_radps**2 / bare
