"""Where the relative acceleration in flight changes sign: the phases that split a flight into branches.

In flight the ball's height above the plate has ``h'' = gamma q - 1``, ``q(phi) = sum_j b_j n_j^2 sin(n_j phi + p_j)``.
Where ``gamma q > 1`` (a take-off window) h is convex, elsewhere concave. No sign change is missed.
The turning points of ``q`` do not depend on gamma; they are isolated by bounds that exclude a root or prove it single.
Between them ``gamma q - 1`` is monotone, so a sign at either end decides.
"""

from __future__ import annotations

import math

import numpy as np

from kernels.arrays import Floats
from model.flight.numerics import compiled, inlined, sincos

TWO_PI = 2.0 * math.pi
NARROWEST = 1e-9  # q cannot change by more than its rounding over a stretch this narrow about a turning point


@compiled
def q_and_slope(tones: Floats, phi: float) -> tuple[float, float]:
    """``q(phi)`` and ``q'(phi)`` of ``tones`` (k, 3)."""
    q = 0.0
    slope = 0.0
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        sine, cosine = sincos(n * phi + tones[j, 2])
        weight = tones[j, 1] * n * n
        q += weight * sine
        slope += weight * n * cosine
    return q, slope


@compiled
def _slope_and_curvature(tones: Floats, phi: float) -> tuple[float, float]:
    """``q'(phi)`` and ``q''(phi)``."""
    slope = 0.0
    curvature = 0.0
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        sine, cosine = sincos(n * phi + tones[j, 2])
        weight = tones[j, 1] * n * n * n
        slope += weight * cosine
        curvature -= weight * n * sine
    return slope, curvature


@compiled
def turning_points(tones: Floats, start: float, stop: float) -> Floats:
    """All phases in ``[start, stop)`` where ``q' = 0``, ascending.

    Bisection with proof: on an interval of half-width r about m, ``|q'(m)| > r max|q''|`` excludes a root and
    ``|q''(m)| > r max|q'''|`` leaves at most one, which the signs at the ends decide.
    """
    bound_curvature = 0.0
    bound_third = 0.0
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        # max|q''| <= sum |b| n^4, max|q'''| <= sum |b| n^5
        bound_curvature += abs(tones[j, 1]) * n**4
        bound_third += abs(tones[j, 1]) * n**5
    found = []
    todo = [(start, stop)]
    while len(todo) > 0:
        lo, hi = todo.pop()
        middle = 0.5 * (lo + hi)
        radius = 0.5 * (hi - lo)
        slope, curvature = _slope_and_curvature(tones, middle)
        if abs(slope) > radius * bound_curvature:
            continue
        if radius < NARROWEST:
            found.append(middle)
        elif abs(curvature) > radius * bound_third:
            at_lo = _slope_and_curvature(tones, lo)[0]
            at_hi = _slope_and_curvature(tones, hi)[0]
            # a root at an end belongs to the interval that begins there, so that none is counted twice
            if at_lo == 0.0 or ((at_lo < 0.0) != (at_hi < 0.0) and at_hi != 0.0):
                found.append(_turning_point_between(tones, lo, hi, at_lo < 0.0))
        else:
            todo.append((middle, hi))
            todo.append((lo, middle))
    return np.array(found)


@compiled
def _turning_point_between(tones: Floats, lo: float, hi: float, rising: bool) -> float:
    """The single root of ``q'`` in ``[lo, hi]``: Newton inside a shrinking bracket."""
    x = 0.5 * (lo + hi)
    for _ in range(200):
        slope, curvature = _slope_and_curvature(tones, x)
        if (slope < 0.0) == rising:
            lo = x
        else:
            hi = x
        step = x - slope / curvature
        new = step if lo < step < hi else 0.5 * (lo + hi)
        if abs(new - x) <= 4e-16 * (1.0 + abs(x)):
            return new
        x = new
    return x


@compiled
def crossing(tones: Floats, gamma: float, lo: float, hi: float, rising: bool) -> float:
    """The single root of ``gamma q - 1`` in ``[lo, hi]``, where it is monotone: Newton inside a bracket."""
    x = 0.5 * (lo + hi)
    for _ in range(200):
        q, slope = q_and_slope(tones, x)
        value = gamma * q - 1.0
        if (value < 0.0) == rising:
            lo = x
        else:
            hi = x
        step = x - value / (gamma * slope)
        new = step if lo < step < hi else 0.5 * (lo + hi)
        if abs(new - x) <= 2e-16 * (1.0 + abs(x)):
            return new
        x = new
    return x


@compiled
def fill_edges(tones: Floats, turning: Floats, gamma: float, edge: Floats) -> int:
    """Fill ``edge`` (m + 2,) with one period's window edges, a window's start first; return the number of windows.

    ``tones`` (k, 3) are a periodic forcing, ``turning`` (m,) its `turning_points` over ``[0, 2 pi)``. On return
    ``edge[0] < edge[1] < ... < edge[2 w]``: window ``i`` is ``[edge[2 i], edge[2 i + 1])``, ``edge[0]`` is in
    ``[0, 2 pi)`` and ``edge[2 w] = edge[0] + 2 pi`` closes the period.
    """
    m = turning.shape[0]
    if m == 0 or gamma <= 0.0:
        return 0
    count, shift = 0, False
    for i in range(m):
        lo = turning[i]
        hi = turning[i + 1] if i + 1 < m else turning[0] + TWO_PI
        below_lo = gamma * q_and_slope(tones, lo)[0] < 1.0
        below_hi = gamma * q_and_slope(tones, hi)[0] < 1.0
        if below_lo != below_hi:
            shift = shift or (count == 0 and not below_lo)
            edge[count] = crossing(tones, gamma, lo, hi, below_lo)
            count += 1
    return arrange(edge, 0, 1, count, shift)


@inlined
def arrange(table: Floats, base: int, row: int, count: int, shift: bool) -> int:
    """Put the ``count`` crossings of a table from ``base`` on in order, a window's start first; how many windows.

    Each crossing has ``row`` numbers, its phase the first of them; where ``shift`` the first one closes a window. There
    is room for one crossing more, which closes the period.
    """
    if count % 2 == 1:  # two turning points equal to rounding disagree about a touch: no window
        count -= 1
    if count == 0:
        return 0
    end = base + row * count
    if shift:
        for k in range(row):
            table[end + k] = table[base + k]
        for k in range(row * count):
            table[base + k] = table[base + k + row]
        table[end - row] += TWO_PI
    # the last crossing may lie past the period's end
    while table[base] >= TWO_PI:
        for k in range(count):
            table[base + row * k] -= TWO_PI
    for k in range(row):
        table[end + k] = table[base + k]
    table[end] += TWO_PI
    return count // 2


@compiled
def fold(phi: float, first_edge: float) -> float:
    """``phi`` shifted by whole turns into ``[first_edge, first_edge + 2 pi)``."""
    folded = phi - TWO_PI * math.floor((phi - first_edge) / TWO_PI)
    # rounding of the quotient may leave a phase one turn off at either end
    if folded < first_edge:
        folded += TWO_PI
    if folded >= first_edge + TWO_PI:
        folded -= TWO_PI
    return folded


@compiled
def branch_of(edge: Floats, n_windows: int, phi: float) -> int:
    """Index ``i`` with ``edge[i] <= phi < edge[i + 1]`` for a folded phase; even means inside a window."""
    i = 0
    while i + 1 < 2 * n_windows and phi >= edge[i + 1]:
        i += 1
    return i
