"""A force that is a smooth function of one quantity of the flight: the missing term itself, where no cause is named.

Piecewise linear between knots, constant beyond them; never part of the named library.
"""

from __future__ import annotations

import math

from kernels import njit
from model.effects.base import CurveOf, Effect, Parameter, Row
from model.effects.curves import curve_parameters, on_curve

EFFECT = Effect(
    name="smooth_force",
    summary="a force as a smooth function of one quantity of the flight",
    parameters=(
        Parameter(
            "of", "1", 0.0, 5.0, 1.0, is_shape=True,
            meaning="0 none, 1 height, 2 velocity, 3 absolute velocity, 4 time since take-off, 5 since impact",
        ),
        Parameter("against", "1", 0.0, 1.0, 1.0, is_shape=True, meaning="1: against the motion, as friction is"),
        Parameter("lag_s", "s", 0.0, 1e3, 1e-2, is_shape=True, meaning="from impact to take-off"),
        *curve_parameters("1", "m/s^2", -1e3, 1e3, 0.1, "force"),
    ),
    reference="penalised regression spline",
    curves=(
        CurveOf("friction", "since_impact_s", {"of": 5.0, "against": 1.0}),
        CurveOf("force", "height_m", {"of": 1.0}),
        CurveOf("force", "velocity_mps", {"of": 2.0}),
        CurveOf("force", "absolute_velocity_mps", {"of": 3.0}),
        CurveOf("force", "since_takeoff_s", {"of": 4.0}),
    ),
    library=False,
)  # fmt: skip


@njit(error_model="numpy")
def force(s: float, h: float, v: float, u: float, p: Row, k: int) -> float:
    """Acceleration of the ball, m/s^2."""
    of = p[k]
    if of == 0.0:
        return 0.0
    x = h if of == 1.0 else v if of == 2.0 else u if of == 3.0 else s if of == 4.0 else s + p[k + 2]
    size = on_curve(x, p, k + 3)
    if p[k + 1] == 0.0:
        return size
    if h <= 0.0 and v == 0.0:  # at rest on the plate it holds the ball down
        return -size
    # the sign changes over 0.01 m/s, not at once: the integrator could not follow a jump
    return float(-size * v / math.hypot(v, 0.01))
