"""Curves for effects that follow a table: straight between knots, constant beyond the outer ones."""

from __future__ import annotations

from kernels import njit
from kernels.arrays import Floats


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
