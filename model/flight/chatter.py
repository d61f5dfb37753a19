"""The tail of a chatter: infinitely many bounces in a finite time, summed.

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
from model.flight.numerics import compiled
from model.flight.records import FrictionRestitution

PHASE_BOUND = 1e-9  # error of the phase of rest
SLOW = 0.02  # rebounds faster than this (in g/w) are never summed


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
