"""Restitution that is a smooth function of the impact speed: the missing term itself, where no cause is named.

Piecewise linear between knots, constant beyond them; never part of the named library.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import CurveOf, Effect, Parameter, Row

KNOTS = 45

EFFECT = Effect(
    name="smooth_restitution",
    summary="restitution as a smooth function of the impact speed",
    parameters=(
        Parameter("start", "m/s", -1e3, 1e3, 1.0, is_shape=True, meaning="first knot"),
        Parameter("spacing", "m/s", 1e-9, 1e3, 1.0, null_value=1.0, is_shape=True, meaning="between knots"),
        *(Parameter(f"c{i}", "1", 0.0, 0.95, 0.02, meaning="restitution at the knot") for i in range(KNOTS)),
    ),
    reference="penalised regression spline",
    curves=(CurveOf("restitution", "impact_mps"),),
    library=False,
)


@njit(error_model="numpy")
def rebound(v: float, p: Row, k: int) -> float:
    """Contribution to the coefficient of restitution."""
    place = min(max((v - p[k]) / p[k + 1], 0.0), KNOTS - 1.0)
    i = min(int(place), KNOTS - 2)
    part = place - i
    return float(p[k + 2 + i] * (1.0 - part) + p[k + 3 + i] * part)
