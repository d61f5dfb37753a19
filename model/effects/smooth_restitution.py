"""Restitution that is a smooth function of the impact speed: the missing term itself, where no cause is named.

Piecewise linear between knots, constant beyond them; never part of the named library.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import CurveOf, Effect, Row
from model.effects.curves import curve_parameters, on_curve

EFFECT = Effect(
    name="smooth_restitution",
    summary="restitution as a smooth function of the impact speed",
    parameters=(*curve_parameters("m/s", "1", 0.0, 0.95, 0.02, "restitution"),),
    reference="penalised regression spline",
    curves=(CurveOf("restitution", "impact_mps"),),
    library=False,
)


@njit(error_model="numpy")
def rebound(v: float, p: Row, k: int) -> float:
    """Contribution to the coefficient of restitution."""
    return on_curve(v, p, k)
