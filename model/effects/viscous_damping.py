"""Viscous damping relative to the plate, ``-rate v``.

It acts on the velocity relative to the plate, since the rod moves with it.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="viscous_damping",
    summary="a drag proportional to the speed along the rod",
    parameters=(Parameter("rate_per_s", "1/s", 0.0, 200.0, 0.5, start_grid=(3.0,), meaning="deceleration over speed"),),
    confused_with={"coulomb_friction": "take-off times", "position_force": "irregular flights at high gamma"},
    reference="linear (lubricated) friction",
)


@njit(error_model="numpy")
def force(s: float, h: float, v: float, u: float, p: Row, k: int) -> float:
    """Acceleration of the ball, m/s^2."""
    return float(-p[k] * v)
