"""Dry friction that weakens with speed: ``mu_kinetic + mu_extra exp(-(v / v_s)^2)``.

At rest the whole of it must be overcome.
"""

from __future__ import annotations

import math

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="stribeck_friction",
    summary="dry friction that weakens with speed",
    parameters=(
        Parameter(
            "mu_kinetic", "g", 0.0, 3.0, 0.02, start_grid=(0.1, 0.3), meaning="friction over weight at high speed"
        ),
        Parameter("mu_extra", "g", 0.0, 3.0, 0.03, start_grid=(0.1,), meaning="what is added at standstill"),
        Parameter(
            "v_s_mps", "m/s", 1e-3, 2.0, 0.05, null_value=0.1, start_grid=(0.03, 0.1, 0.3), is_shape=True,
            meaning="speed over which it weakens",
        ),
        Parameter(
            "exponent", "1", 0.5, 2.0, 0.2, null_value=2.0, start_grid=(1.0, 2.0), is_shape=True,
            meaning="how abruptly it weakens",
        ),
    ),
    confused_with={"coulomb_friction": "slow and fast passages", "adhesion": "landing times of fast flights"},
    special_cases={"coulomb_friction": {"mu_up": "mu_kinetic", "mu_down": "mu_kinetic"}},
    reference="Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30, 1083 (1994)",
)  # fmt: skip


@njit(error_model="numpy")
def dry_friction(h: float, speed: float, direction: float, p: Row, k: int) -> float:
    """Friction as an acceleration, m/s^2."""
    if p[k + 1] == 0.0:
        return float(p[-1] * p[k])
    return float(p[-1] * (p[k] + p[k + 1] * math.exp(-((speed / p[k + 2]) ** p[k + 3]))))
