"""A force that is a smooth function of one quantity of the flight: the missing term itself, where no cause is named.

Piecewise linear between knots, constant beyond them; never part of the named library.
"""

from __future__ import annotations

import math

from kernels import njit
from model.effects.base import CurveOf, Effect, Parameter, Row

KNOTS = 45

EFFECT = Effect(
    name="smooth_force",
    summary="a force as a smooth function of one quantity of the flight",
    parameters=(
        Parameter(
            "of",
            "1",
            0.0,
            5.0,
            1.0,
            is_shape=True,
            meaning="0 none, 1 height, 2 velocity, 3 absolute velocity, 4 time since take-off, 5 since impact",
        ),
        Parameter("against", "1", 0.0, 1.0, 1.0, is_shape=True, meaning="1: against the motion, as friction is"),
        Parameter("lag_s", "s", 0.0, 1e3, 1e-2, is_shape=True, meaning="from impact to take-off"),
        Parameter("start", "1", -1e3, 1e3, 1.0, is_shape=True, meaning="first knot"),
        Parameter("spacing", "1", 1e-9, 1e3, 1.0, null_value=1.0, is_shape=True, meaning="between knots"),
        *(Parameter(f"c{i}", "m/s^2", -1e3, 1e3, 0.1, meaning="force at the knot") for i in range(KNOTS)),
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
)


@njit(error_model="numpy")
def force(s: float, h: float, v: float, u: float, p: Row, k: int) -> float:
    """Acceleration of the ball, m/s^2."""
    of = p[k]
    if of == 0.0:
        return 0.0
    x = h if of == 1.0 else v if of == 2.0 else u if of == 3.0 else s if of == 4.0 else s + p[k + 2]
    # constant beyond the outer knots
    place = min(max((x - p[k + 3]) / p[k + 4], 0.0), KNOTS - 1.0)
    i = min(int(place), KNOTS - 2)
    part = place - i
    size = p[k + 5 + i] * (1.0 - part) + p[k + 6 + i] * part
    if p[k + 1] == 0.0:
        return float(size)
    if h <= 0.0 and v == 0.0:  # at rest on the plate it holds the ball down
        return float(-size)
    # the sign changes over 0.01 m/s, not at once: the integrator could not follow a jump
    return float(-size * v / math.hypot(v, 0.01))
