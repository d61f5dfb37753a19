"""Restitution relative to the plate, ``e = e0 - e1 v`` with ``v`` the impact speed.

E is never below 0.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import Effect, Parameter, Row

EFFECT = Effect(
    name="restitution",
    summary="the ball rebounds: its impacts are not completely inelastic",
    parameters=(
        Parameter(
            "e0", "1", 0.0, 0.95, 0.02,
            start_grid=(0.001, 0.002, 0.004, 0.008, 0.014, 0.02, 0.03, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8),
            coarse_grid=(0.03, 0.1, 0.17, 0.25, 0.32, 0.4, 0.46, 0.52, 0.6, 0.7, 0.8), coarse_step=0.03,
            calibrated_by={"drop test": 5e-3}, carries_term="restitution",
            meaning="coefficient of restitution of a slow impact",
        ),
        Parameter("e1_s_per_m", "s/m", -1.0, 2.0, 0.05, meaning="loss of restitution with impact speed"),
    ),
    variants=(("e0",), ("e0", "e1_s_per_m")),
    confused_with={"coulomb_friction": "undeclared friction biases restitution: they are fitted jointly"},
    substitutes_term="restitution",
    reference="Gilet, Vandewalle and Dorbolo, Phys. Rev. E 79, 055201 (2009), for e = 0",
)  # fmt: skip


@njit(error_model="numpy")
def rebound(v: float, p: Row, k: int) -> float:
    """Contribution to the coefficient of restitution."""
    return float(max(p[k] - p[k + 1] * v, 0.0) if p[k] > 0.0 else 0.0)
