"""Coulomb friction of the rod, ``-mu g sign(v)`` against the motion relative to the plate, held in mid-air when it can.

Static equals kinetic, so the ball leaves when ``-a_p > g (1 + mu_up)``.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import Effect, Parameter, Row


def _mu(way: str) -> Parameter:
    """Friction on the ``way`` up or down."""
    return Parameter(
        f"mu_{way}", "g", 0.0, 3.0, 0.02, start_grid=(0.1, 0.3), coarse_grid=(0.05, 0.12, 0.2, 0.3, 0.45),
        coarse_step=0.03, calibrated_by={"drop test": 1e-2}, carries_term="friction",
        meaning=f"friction over weight, moving {way}",
    )  # fmt: skip


EFFECT = Effect(
    name="coulomb_friction",
    summary="dry friction of the rod, the same at any speed",
    parameters=(_mu("up"), _mu("down")),
    confused_with={
        "stribeck_friction": "slow and fast passages: high gamma",
        "viscous_damping": "gamma far into the irregular range",
        "local_gravity": "c = 2, or drops up and down",
    },
    tied={"mu": ("mu_up", "mu_down")},
    substitutes_term="friction",
    reference="Coulomb (1785); seed paper: about 0.3 g on the rod",
)


@njit(error_model="numpy")
def dry_friction(h: float, speed: float, direction: float, p: Row, k: int) -> float:
    """Friction as an acceleration, m/s^2."""
    return float(p[-1] * (p[k] if direction > 0.0 else p[k + 1]))
