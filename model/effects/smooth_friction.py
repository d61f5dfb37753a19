"""Dry friction that is a smooth function of height or of speed: the missing term itself, where no cause is named.

Piecewise linear between knots, constant beyond them, never negative; not part of the named library.
"""

from __future__ import annotations

from kernels import njit
from model.effects.base import CurveOf, Effect, Parameter, Row
from model.effects.curves import curve_parameters, on_curve

EFFECT = Effect(
    name="smooth_friction",
    summary="dry friction as a smooth function of height or speed",
    parameters=(
        Parameter("of", "1", 0.0, 2.0, 1.0, is_shape=True, meaning="0 none, 1 height, 2 speed relative to the plate"),
        *curve_parameters("1", "g", 0.0, 3.0, 0.02, "friction over weight"),
    ),
    reference="penalised regression spline",
    curves=(CurveOf("friction", "height_m", {"of": 1.0}), CurveOf("friction", "speed_mps", {"of": 2.0})),
    library=False,
)


@njit(error_model="numpy")
def dry_friction(h: float, speed: float, direction: float, p: Row, k: int) -> float:
    """Friction as an acceleration, m/s^2."""
    if p[k] == 0.0:
        return 0.0
    x = h if p[k] == 1.0 else speed
    return float(p[-1] * max(on_curve(x, p, k + 1), 0.0))
