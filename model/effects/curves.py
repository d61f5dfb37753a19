"""Curves for effects that follow a table: straight between knots, constant beyond the outer ones."""

from __future__ import annotations

from kernels import njit
from kernels.arrays import Floats
from model.effects.base import Parameter, Row

KNOTS = 45  # of a curve among an effect's parameters


@njit(error_model="numpy")
def straight_between(x: float, knots: Floats, values: Floats) -> float:
    """Value at ``x`` of the curve through ``values`` (k,) at rising ``knots`` (k,); 0 where ``x`` is NaN."""
    if not x <= knots[-1]:
        return float(values[-1]) if x > knots[-1] else 0.0
    if x <= knots[0]:
        return float(values[0])
    i, j = 0, len(knots) - 1
    while j - i > 1:
        middle = (i + j) // 2
        if knots[middle] <= x:
            i = middle
        else:
            j = middle
    return float(values[i] + (values[j] - values[i]) * (x - knots[i]) / (knots[j] - knots[i]))


def curve_parameters(x_unit: str, unit: str, low: float, high: float, scale: float, meaning: str) -> list[Parameter]:
    """First knot, spacing and values of a curve over ``x_unit``; the rest is of its values, as `Parameter` takes it."""
    return [
        Parameter("start", x_unit, -1e3, 1e3, 1.0, is_shape=True, meaning="first knot"),
        Parameter("spacing", x_unit, 1e-9, 1e3, 1.0, null_value=1.0, is_shape=True, meaning="between knots"),
        *(Parameter(f"c{i}", unit, low, high, scale, meaning=f"{meaning} at the knot") for i in range(KNOTS)),
    ]


@njit(error_model="numpy")
def on_curve(x: float, p: Row, start: int) -> float:
    """Value at ``x`` of the curve whose `curve_parameters` stand in ``p`` from ``start`` on; constant beyond."""
    place = min(max((x - p[start]) / p[start + 1], 0.0), KNOTS - 1.0)
    i = min(int(place), KNOTS - 2)
    part = place - i
    return float(p[start + 2 + i] * (1.0 - part) + p[start + 3 + i] * part)
