"""A force that depends on the height above the plate: a spring, or a magnet near the plate.

Positive numbers pull the ball towards the plate.
"""

from __future__ import annotations

import math

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="position_force",
    summary="a force that depends on the height above the plate (spring, magnet)",
    parameters=(
        Parameter(
            "spring_per_s2", "1/s^2", -5000.0, 5000.0, 10.0, start_grid=(-50.0, 50.0), meaning="stiffness over mass"
        ),
        Parameter("magnet_mps2", "m/s^2", -50.0, 50.0, 0.2, start_grid=(-1.0, 1.0), meaning="pull at the plate"),
        Parameter(
            "range_m", "m", 1e-4, 0.1, 1e-3, null_value=2e-3, start_grid=(1e-3, 4e-3), is_shape=True,
            meaning="height over which the magnet's pull falls by e",
        ),
    ),
    variants=(("spring_per_s2",), ("magnet_mps2", "range_m"), ("spring_per_s2", "magnet_mps2", "range_m")),
    special_cases={"local_gravity": {"excess_mps2": "magnet_mps2"}},  # a pull of long range is a constant one
    confused_with={"viscous_damping": "irregular flights at high gamma", "local_gravity": "short and long flights"},
    reference="Hooke's law; the near field of a small magnet, as an exponential",
)  # fmt: skip


@njit(error_model="numpy")
def force(s: float, h: float, v: float, u: float, p: Row, k: int) -> float:
    """Acceleration of the ball, m/s^2."""
    pull = p[k] * h
    if p[k + 1] != 0.0:
        pull += p[k + 1] * math.exp(-h / p[k + 2])
    return float(-pull)
