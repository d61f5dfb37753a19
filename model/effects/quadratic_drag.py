"""Air drag, ``-k |u| u`` with the absolute velocity ``u``: the air does not move with the plate.

The air is at rest in the laboratory.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="quadratic_drag",
    summary="air drag, proportional to the square of the absolute velocity",
    parameters=(Parameter("k_per_m", "1/m", 0.0, 50.0, 0.1, start_grid=(0.5,), meaning="rho C_d S / (2 m)"),),
    confused_with={"viscous_damping": "fast flights at high gamma"},
    reference="Rayleigh's drag equation",
)


@njit(error_model="numpy")
def force(s: float, h: float, v: float, u: float, p: Row, k: int) -> float:
    """Acceleration of the ball, m/s^2."""
    return float(-p[k] * abs(u) * u)
