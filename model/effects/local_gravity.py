"""The place's gravity differs from the declared one.

The place's g is known to 1e-4 unless the profile says otherwise.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="local_gravity",
    summary="gravity at the place differs from the declared value",
    parameters=(
        Parameter(
            "excess_mps2", "m/s^2", -3.0, 3.0, 0.02, calibration=1e-3, stated_by="g_mps2", carries_term="force",
            meaning="true minus declared",
        ),
    ),
    confused_with={
        "accelerometer_gain": "the same together with drive_gain: only an absolute scale (flip test) tells",
        "coulomb_friction": "drops up and down",
    },
    reference="g varies by 0.5 % over the Earth; more is an inclined rod or a wrong profile",
)  # fmt: skip


@njit(error_model="numpy")
def gravity(p: Row, k: int) -> float:
    """Constant downward acceleration of the ball besides the local g, m/s^2."""
    return float(p[k])
