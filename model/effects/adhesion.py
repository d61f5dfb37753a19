"""Adhesion to the plate: a pull that must be overcome at take-off, growing with the time spent in contact.

It ends the moment the ball has left.
"""

from __future__ import annotations

import math

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="adhesion",
    summary="the ball sticks to the plate and leaves late",
    parameters=(
        Parameter(
            "a_mps2", "m/s^2", 0.0, 30.0, 0.2, start_grid=(1.0,), carries_term="threshold",
            meaning="pull-off force over mass",
        ),
        Parameter(
            "dwell_s", "s", 0.0, 1.0, 0.01, is_shape=True, start_grid=(0.01,),
            meaning="contact time over which it builds up; 0 at once",
        ),
    ),
    variants=(("a_mps2",), ("a_mps2", "dwell_s")),
    confused_with={"contact_gap": "landing times, dwell time", "coulomb_friction": "landing times of long flights"},
    substitutes_term="threshold",
    reference="Johnson, Kendall and Roberts, Proc. R. Soc. A 324, 301 (1971)",
)  # fmt: skip


@njit(error_model="numpy")
def takeoff_threshold(dwell_s: float, p: Row, k: int) -> float:
    """Acceleration to be overcome at take-off, m/s^2."""
    if p[k] <= 0.0 or p[k + 1] <= 0.0:
        return float(p[k])
    return float(p[k] * (1.0 - math.exp(-dwell_s / p[k + 1])))
