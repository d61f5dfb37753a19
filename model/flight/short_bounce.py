"""A short bounce, by the Taylor series of the plate's motion about the impact.

Most flights of a bouncing ball are short, and both their halves lie within one expansion of the plate's motion: two
Newton iterations on polynomials replace all trigonometry but the one at the impact. A bounce is
taken only where the pull provably keeps its sign, so that either half has one root and no more.
"""

from __future__ import annotations

import math

from kernels.arrays import Floats
from model.flight.numerics import compiled, sincos
from model.flight.records import FrictionRestitution

REACH = 0.25  # of the highest harmonic's phase: the first term left out, at order 11, is below 1e-14 of gamma
NEWTON = 8
CONVERGED = 1e-9  # relative; the next step is the square of it

Series = tuple[float, float, float, float, float, float, float, float]


@compiled
def _rest(c: Series, t: float) -> tuple[float, float, float]:
    """``G = sum_{m = 3}^{10} c_m t^m`` and its two derivatives."""
    c3, c4, c5, c6, c7, c8, c9, c10 = c
    g = c3 + t * (c4 + t * (c5 + t * (c6 + t * (c7 + t * (c8 + t * (c9 + t * c10))))))
    g1 = 3 * c3 + t * (4 * c4 + t * (5 * c5 + t * (6 * c6 + t * (7 * c7 + t * (8 * c8 + t * (9 * c9 + t * 10 * c10))))))
    g2 = 6 * c3 + t * (
        12 * c4 + t * (20 * c5 + t * (30 * c6 + t * (42 * c7 + t * (56 * c8 + t * (72 * c9 + t * 90 * c10)))))
    )
    return t * t * t * g, t * t * g1, t * g2


@compiled
def _series(tones: Floats, gamma: float, phi: float) -> tuple[float, Series]:
    """``gamma q(phi)`` and the Taylor coefficients of ``-gamma s`` from order 3."""
    c3 = c4 = c5 = c6 = c7 = c8 = c9 = c10 = pull = 0.0
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        sine, cosine = sincos(n * phi + tones[j, 2])
        n2 = n * n
        sine *= gamma * tones[j, 1] * n2
        cosine *= gamma * tones[j, 1] * n2 * n
        pull += sine
        c3 += cosine
        sine *= n2
        c4 += sine
        cosine *= n2
        c5 += cosine
        sine *= n2
        c6 += sine
        cosine *= n2
        c7 += cosine
        sine *= n2
        c8 += sine
        cosine *= n2
        c9 += cosine
        c10 += sine * n2
    series = (
        c3 / 6.0, -c4 / 24.0, -c5 / 120.0, c6 / 720.0, c7 / 5040.0, -c8 / 40320.0, -c9 / 362880.0, c10 / 3628800.0
    )  # fmt: skip
    return pull, series


@compiled
def surely_long(tones: Floats, law: FrictionRestitution, pull: float, v0: float) -> bool:
    """Whether `short_bounce` leaves a bounce alone that begins where the plate's acceleration is ``pull``, for length.

    A thousandth is left for the rounding of ``pull``.
    """
    a, d = 1.0 + law.mu_up - pull, 1.0 - law.mu_down - pull
    longest = 1.5 * v0 * (1.0 / a + 1.0 / math.sqrt(a * d)) if d > 0.0 else math.inf
    reached: float = tones[tones.shape[0] - 1, 0] * longest
    return reached > 1.001 * REACH


@compiled
def short_bounce(
    tones: Floats, gamma: float, law: FrictionRestitution, phi: float, v0: float
) -> tuple[bool, float, float]:
    """``(taken, tau, impact speed)`` of the flight from the plate at ``phi`` with relative speed ``v0 > 0``.

    Not taken where it is not short, or where the pull might change its sign; then fly it segment by segment.
    """
    pull, series = _series(tones, gamma, phi)
    a = 1.0 + law.mu_up - pull
    d = 1.0 - law.mu_down - pull
    if d <= 0.0:
        return False, 0.0, 0.0
    longest = 1.5 * v0 * (1.0 / a + 1.0 / math.sqrt(a * d))
    top = tones[tones.shape[0] - 1, 0]
    snap = 0.0
    for j in range(tones.shape[0]):
        snap += gamma * tones[j, 1] * tones[j, 0] ** 4
    changed = longest * (6.0 * abs(series[0]) + 0.5 * snap * longest)
    if top * longest > REACH or changed > 0.25 * d:  # then the bounce is indeed shorter than `longest`
        return False, 0.0, 0.0
    t = v0 / a
    for _ in range(NEWTON):
        _, g1, g2 = _rest(series, t)
        step = (v0 - a * t + g1) / (g2 - a)
        t -= step
        if abs(step) <= CONVERGED * t:
            break
    g_top, g1_top, _ = _rest(series, t)
    top_height = t * (v0 - 0.5 * a * t) + g_top
    x = math.sqrt(2.0 * top_height / d)
    speed = 0.0
    for _ in range(NEWTON):
        g, g1, g2 = _rest(series, t + x)
        speed = d * x - (g1 - g1_top)
        step = -(top_height - 0.5 * d * x * x + g - g_top - g1_top * x) / speed
        x -= step
        if abs(step) <= CONVERGED * x:
            speed -= (d - g2) * step
            break
    return True, t + x, speed
