"""Bases of smooth curves: natural cubic splines by their values at knots, and their bending energy.

A curve is cubic between its knots and constant beyond them; a straight line has no bending energy.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.linear_algebra import solve
from kernels.arrays import Floats

ENDS = (0.01, 0.99)  # quantiles at which a covariate's first and last knot lie


def knots_of(x: Floats, most: int = 12) -> Floats:
    """Knots between evenly spaced ones and quantiles of ``x``; its own values where there are few."""
    known = x[np.isfinite(x)]
    seen = np.unique(known)
    if len(seen) <= most:
        return np.asarray(seen, dtype=np.float64)
    first, last = np.quantile(known, ENDS)
    even = np.linspace(first, last, most)
    dense = np.quantile(known, np.linspace(ENDS[0], ENDS[1], most))
    return np.asarray(np.unique(0.5 * (even + dense)))


def hat_functions(x: Floats, knots: Floats) -> Floats:
    """Hat functions of the knots at ``x``, (n, k); 0 where ``x`` is not known."""
    if len(knots) == 1:
        return np.isfinite(x).astype(np.float64)[:, None]
    out = np.column_stack([np.interp(np.nan_to_num(x), knots, row) for row in np.eye(len(knots))])
    return out * np.isfinite(x)[:, None]


def basis_of(x: Floats, knots: Floats) -> Floats:
    """Natural cubic splines that are 1 at one knot and 0 at the others, (n, k); 0 where ``x`` is not known."""
    if len(knots) < 3:
        return hat_functions(x, knots)
    inside = np.clip(np.nan_to_num(x), knots[0], knots[-1])
    out = np.asarray(CubicSpline(knots, np.eye(len(knots)), bc_type="natural")(inside))
    return out * np.isfinite(x)[:, None]


def penalty_of(knots: Floats) -> Floats:
    """Integral of the squared second derivative by the values at the knots, (k, k), mean spacing taken for one.

    Green and Silverman, Nonparametric Regression and Generalized Linear Models (1994), equation 2.4: Q R^-1 Q^T.
    """
    return _penalty(tuple(knots.tolist()))


@functools.lru_cache(maxsize=256)
def _penalty(places: tuple[float, ...]) -> Floats:
    k, knots = len(places), np.array(places)
    if k < 3:
        return np.zeros((k, k))
    h = np.diff(knots) * (k - 1) / (knots[-1] - knots[0])
    q, r = np.zeros((k, k - 2)), np.zeros((k - 2, k - 2))
    for j in range(k - 2):
        q[j : j + 3, j] = 1.0 / h[j], -1.0 / h[j] - 1.0 / h[j + 1], 1.0 / h[j + 1]
        r[j, j] = (h[j] + h[j + 1]) / 3.0
        if j:
            r[j - 1, j] = r[j, j - 1] = h[j] / 6.0
    return np.asarray(q @ solve(r, q.T))
