"""Bounces without a walk: a short one by a series about its impact, and the tail of a chatter, summed.

**A short bounce.** Most flights of a bouncing ball are short, and both their halves lie within one expansion of the
plate's motion: two Newton iterations on polynomials replace all trigonometry but the one at the impact. A bounce is
taken only where the pull provably keeps its sign, so that either half has one root and no more.

**The tail of a chatter**: infinitely many bounces in a finite time.
On a plate whose pull changes slowly over one bounce, a rebound at ``v`` comes to rest after the time
``Phi(v) = alpha v + beta v^2 + O(v^3)``. One bounce takes ``T = A v + T2 v^2`` and returns ``V = rho v + V2 v^2``, so
``Phi(v) = T + Phi(V)``, with the coefficients taken at the phase of each impact, gives

    alpha = A / (1 - rho),    beta = (T2 + A rho alpha' + alpha V2) / (1 - rho^2),

``'`` being the derivative with the phase. With ``a`` and ``d`` the accelerations back to the plate going up and down,
both changing at the rate ``-j`` (j the jerk): ``A = 1/a + 1/sqrt(a d)`` and ``rho = e0 sqrt(d/a)``.

The sum is taken only where its first neglected term is below `PHASE_BOUND`; sooner the bounces are
flown one by one.
"""

from __future__ import annotations

import math

from kernels.arrays import Floats
from model.flight.branches import q_and_slope
from model.flight.numerics import FrictionRestitution, compiled, sincos

REACH = 0.25  # of the highest harmonic's phase: the first term left out, at order 11, is below 1e-14 of gamma
NEWTON = 8
CONVERGED = 1e-9  # relative; the next step is the square of it
PHASE_BOUND = 1e-9  # error of the phase of rest after a chatter
SLOW = 0.02  # rebounds faster than this (in g/w) are never summed

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
    """Whether a bounce that begins where the plate's acceleration is ``pull`` is too long for `short_bounce`.

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
    # up: Newton for h' = 0 from the time under the pull at the impact
    t = v0 / a
    for _ in range(NEWTON):
        _, g1, g2 = _rest(series, t)
        step = (v0 - a * t + g1) / (g2 - a)
        t -= step
        if abs(step) <= CONVERGED * t:
            break
    g_top, g1_top, _ = _rest(series, t)
    top_height = t * (v0 - 0.5 * a * t) + g_top
    # down: Newton for h = 0, counted from the top, where the height is a difference of small numbers
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


@compiled
def tail_of_chatter(tones: Floats, gamma: float, law: FrictionRestitution, phi: float, v: float) -> float:
    """Time from the rebound at ``phi`` with speed ``v`` to rest, to `PHASE_BOUND`; -1 where it cannot be summed yet."""
    mu_up, mu_down, e0, e1 = law
    if v > SLOW:
        return -1.0
    q, slope = q_and_slope(tones, phi)
    a = 1.0 + mu_up - gamma * q
    d = 1.0 - mu_down - gamma * q
    if d <= 0.0:
        return -1.0
    jerk = gamma * slope
    ratio = math.sqrt(d / a)
    # rebounds that do not shrink have no last one: the plate's pull outweighs the restitution
    rho = e0 * ratio
    if rho >= 1.0:
        return -1.0
    w = 1.0 / math.sqrt(a * d)
    total = (1.0 / a + w) / (1.0 - rho) * v
    snap = 0.0
    for j in range(tones.shape[0]):
        snap += gamma * tones[j, 1] * tones[j, 0] ** 4
    turn = abs(jerk) * total / d  # how far the pull changes meanwhile, and how fast e does
    if total * (4.0 * turn * turn + snap * total * total / d + 4.0 * (e1 * v) ** 2) / (1.0 - rho) > PHASE_BOUND:
        return -1.0
    # second order: what the jerk changes in rise, fall and return speed of one bounce
    kappa = (jerk / (6.0 * a**3) + 0.5 * jerk * w * w / a + jerk * w**3 / 6.0) / (d * w)
    t2 = 0.5 * jerk / a**3 + kappa
    u2 = d * kappa - jerk * w / a - 0.5 * jerk * w * w  # of the impact speed: ratio v + u2 v^2
    v2 = e0 * u2 - e1 * ratio * ratio
    big_a = 1.0 / a + w
    big_a_rate = jerk / (a * a) + 0.5 * jerk * w * (1.0 / a + 1.0 / d)
    rho_rate = 0.5 * e0 * jerk * (d - a) / (a * a * ratio)
    alpha = big_a / (1.0 - rho)
    alpha_rate = big_a_rate / (1.0 - rho) + big_a * rho_rate / (1.0 - rho) ** 2
    beta = (t2 + big_a * rho * alpha_rate + alpha * v2) / (1.0 - rho * rho)
    return v * (alpha + beta * v)
