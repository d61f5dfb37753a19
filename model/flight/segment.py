"""A segment of a flight: the motion while gravity and friction keep their sign, and the roots of its height.

From a phase ``phi0`` with height ``h0`` and relative speed ``v0``, under a steady pull ``level`` (1 for the ideal ball,
``1 + mu_up`` going up and ``1 - mu_down`` going down a rough rod), the height above the plate is

    h(tau) = h0 + gamma [s(phi0) - s(phi0 + tau)] + gamma s'(phi0) tau + v0 tau - level tau^2 / 2,
    s(phi) = sum_j b_j sin(n_j phi + p_j),

the paper's eq. 4 when ``h0 = v0 = 0`` and ``level = 1``. Its second derivative is ``gamma q - level``, so the edges of
`model.flight.branches` at ``gamma / level`` split it into convex and concave branches. A root is
returned only when it is proven to be the first of its branch. A concave branch entered above the plate holds a root
only if it ends below, and then one; in a convex one Newton from the left cannot pass the first root, and ``h' >= 0``
with ``h > 0`` proves there is none.
"""

from __future__ import annotations

import math
from typing import Any

from kernels.arrays import Floats
from kernels.lanes import root, select
from model.flight.branches import TWO_PI, branch_of
from model.flight.numerics import Number, Segment, compiled, cosine_series, inlined, sincos, sine_series

UNDECIDED = 2  # a graze closer than double precision can tell
SHORT = 0.125  # over shorter times the height is computed as tau^2 times a series: the plain sum is rounding noise
ROUNDING = 32 * 2.2e-16  # bound on the relative rounding of a height


@inlined
def shape(tones: Floats, phi: Number) -> tuple[Number, Number, Number]:
    """``s(phi)``, ``s'(phi)`` and ``q(phi) = -s''(phi)``."""
    s = slope = q = 0.0 * phi
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        sine, cosine = sincos(n * phi + tones[j, 2])
        sine = tones[j, 1] * sine
        s = s + sine
        slope = slope + tones[j, 1] * n * cosine
        q = q + n * n * sine
    return s, slope, q


@inlined
def height(gamma: Number, segment: Segment, s: Number, slope: Number, tau: Number) -> tuple[Number, Number]:
    """``h`` and ``h'`` where the plate's ``s`` and ``s'`` are given, ``tau`` after the start of ``segment``."""
    _, s0, slope0, _, v0, h0, level = segment
    h = h0 + gamma * (s0 + slope0 * tau - s) + tau * (v0 - 0.5 * level * tau)
    return h, gamma * (slope0 - slope) + v0 - level * tau


@compiled
def segment_from(
    tones: Floats, gamma: float, phi0: float, v0: float, h0: float, level: float, at_threshold: bool
) -> Segment:
    """The segment that starts at ``phi0``; ``at_threshold`` says that ``gamma q = level`` there exactly."""
    s0, slope0, q0 = shape(tones, phi0)
    return Segment(phi0, s0, slope0, 0.0 if at_threshold else gamma * q0 - level, v0, h0, level)


@compiled
def _remainders(x: float) -> tuple[float, float, float, float]:
    """``(1 - cos x)/x^2 - 1/2``, ``(x - sin x)/x^2``, ``sin x/x - 1`` and ``(1 - cos x)/x`` without cancellation."""
    y = x * x
    if y < 1.0:
        cosine, sine = y * cosine_series(y), sine_series(y)
        return -cosine, -x * sine, y * sine, x * (0.5 - cosine)
    # 1 - cos x = 2 sin^2(x / 2) keeps its digits where cos x is near 1
    sine_half = math.sin(0.5 * x)
    one_minus_cos = 2.0 * sine_half * sine_half
    sine = math.sin(x)
    return one_minus_cos / y - 0.5, (x - sine) / y, sine / x - 1.0, one_minus_cos / x


@compiled
def _motion_short(tones: Floats, gamma: float, segment: Segment, tau: float) -> tuple[float, float, float]:
    """`motion` at a small ``tau`` with a small *relative* error of ``h - h0`` and ``h'``."""
    g = 0.5 * segment.acceleration
    g_slope = segment.acceleration
    a = segment.acceleration
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        sine, cosine = sincos(n * segment.phase + tones[j, 2])
        weight = gamma * tones[j, 1] * n * n
        sine *= weight
        cosine *= weight
        x = n * tau
        cos_part, sin_part, sinc_part, vers_part = _remainders(x)
        g += sine * cos_part + cosine * sin_part
        g_slope += sine * sinc_part + cosine * vers_part
        a += x * (cosine * (1.0 + sinc_part) - sine * vers_part)
    return segment.height + tau * (segment.speed + tau * g), segment.speed + tau * g_slope, a


@compiled
def motion(tones: Floats, gamma: float, segment: Segment, phi: float, tau: float) -> tuple[float, float, float]:
    """``h, h', h''`` at the phase ``phi`` (any turn), ``tau`` after the start of ``segment``."""
    if tau < SHORT:
        return _motion_short(tones, gamma, segment, tau)
    s, slope, q = shape(tones, phi)
    h, h1 = height(gamma, segment, s, slope, tau)
    return h, h1, gamma * q - segment.pull


@compiled
def rounding_of_height(tones: Floats, gamma: float, segment: Segment, tau: float) -> float:
    """Bound on the rounding error of the height from `motion` at ``tau``."""
    size = 0.0
    if tau < SHORT:
        for j in range(tones.shape[0]):
            size += tones[j, 1] * tones[j, 0] ** 2
        return ROUNDING * (segment.height + tau * (segment.speed + tau * (segment.pull + gamma * size)))
    for j in range(tones.shape[0]):
        size += tones[j, 1]
    return ROUNDING * (
        segment.height + gamma * (size + abs(segment.slope) * tau) + tau * (segment.speed + segment.pull * tau)
    )


@compiled
def root_in_concave(
    tones: Floats, gamma: float, segment: Segment, turns: float, lo: float, hi: float, guess: float
) -> tuple[float, float]:
    """The one root in ``(lo, hi]`` of a branch with ``h(lo) >= 0 >= h(hi)``, and ``-h'`` there: Halley in a bracket.

    ``guess`` is where to begin; phases are those of the branch, ``turns`` more than the segment's.
    """
    x = guess if lo < guess < hi else 0.5 * (lo + hi)
    h1 = 0.0
    for _ in range(100):
        tau = x - segment.phase + turns
        h, h1, h2 = motion(tones, gamma, segment, x, tau)
        if h > 0.0:
            lo = x
        elif h < 0.0:
            hi = x
        else:
            return x, -h1
        # Halley's step only where it goes the right way and is no longer than twice Newton's; else bisection
        determinant = 2.0 * h1 * h1 - h * h2
        if h1 < 0.0 and determinant > h1 * h1:
            step = 2.0 * h * h1 / determinant
            size = abs(step)
            if size <= 1e-6 * min(1.0, tau) and size * abs(h2) <= -1e-6 * h1:  # Halley's next error: below 1e-18
                return x - step, h2 * step - h1
            new = x - step
        else:
            new = lo
        if not lo < new < hi:
            new = 0.5 * (lo + hi)
            if new in (lo, hi):
                return new, -h1
        x = new
    return x, -h1


@compiled
def root_in_convex(
    tones: Floats, gamma: float, segment: Segment, turns: float, lo: float, hi: float
) -> tuple[bool, float, float, int]:
    """First root in ``(lo, hi]`` of a branch entered with ``h > 0 > h'``: ``(found, phase, -h', flag)``.

    A minimum nearer to zero than the rounding of h is flagged: double precision cannot decide it.
    """
    x = lo
    flag = 0
    h1 = 0.0
    for _ in range(200):
        tau = x - segment.phase + turns
        h, h1, h2 = motion(tones, gamma, segment, x, tau)
        if abs(h - 0.5 * h1 * h1 / h2) < rounding_of_height(tones, gamma, segment, tau):
            flag = UNDECIDED
        if h1 >= 0.0:
            return False, x, 0.0, flag
        if h <= 0.0:
            return True, x, -h1, flag
        step = -h / h1
        x += step
        if x > hi:
            return False, x, 0.0, flag
        if step <= 1e-8 * min(1.0, tau) and step * h2 <= -1e-8 * h1:  # Newton's next step: below 1e-16
            return True, x, -h1 - h2 * step, flag
    return True, x, -h1, UNDECIDED


@compiled
def standstill(
    tones: Floats, gamma: float, segment: Segment, turns: float, lo: float, hi: float, guess: float, rising: bool
) -> float:
    """The one phase in ``(lo, hi]`` where ``h' = 0``; ``rising`` says that it enters the branch below zero.

    Newton inside a bracket, from ``guess``: on a branch ``h'`` is monotone.
    """
    x = guess if lo < guess <= hi else 0.5 * (lo + hi)
    for _ in range(100):
        tau = x - segment.phase + turns
        _, h1, h2 = motion(tones, gamma, segment, x, tau)
        if h1 == 0.0:
            return x
        if (h1 < 0.0) == rising:
            lo = x
        else:
            hi = x
        step = h1 / h2
        if abs(step) <= 1e-8 * min(1.0, tau):  # Newton's next step: below 1e-16
            return min(max(x - step, lo), hi)
        new = x - step
        if not lo < new < hi:
            new = 0.5 * (lo + hi)
            if new in (lo, hi):
                return new
        x = new
    return x


@compiled
def total_speed(tones: Floats) -> float:
    """Bound on ``|s'|``."""
    total = 0.0
    for j in range(tones.shape[0]):
        total += tones[j, 0] * tones[j, 1]
    return total


@inlined
def clear_times(highest: float, gamma: Number, s0: Number, h0: Number, v: Number, level: Number) -> Any:
    """Times between which the plate at its highest stays below a ball of speed ``v``; (1, 0) when there are none."""
    discriminant = v * v - 2.0 * level * (gamma * (highest - s0) - h0)
    r = root(select(discriminant > 0.0, discriminant, 0.0))
    return select(discriminant > 0.0, (v - r) / level, 1.0), select(discriminant > 0.0, (v + r) / level, 0.0)


@compiled
def _fall_for_ever(tones: Floats, gamma: float, segment: Segment) -> tuple[bool, float, float, float, int]:
    """`landing_or_standstill` on a plate that throws no ball: concave for ever, any point below ends the bracket."""
    phi0, v0 = segment.phase, segment.speed
    reach = 1.0
    # the pull wins in the end, so some doubled time lies below the plate
    while motion(tones, gamma, segment, phi0 + reach, reach)[0] > 0.0:
        reach *= 2.0
    guess = (v0 + math.sqrt(v0 * v0 + 2.0 * segment.pull * segment.height)) / segment.pull
    x, speed = root_in_concave(tones, gamma, segment, 0.0, phi0, phi0 + reach, phi0 + min(guess, reach))
    return True, x - phi0, x, speed, 0


@inlined  # with ``stops`` known the compiler leaves out the other half
def landing_or_standstill(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, segment: Segment, stops: bool
) -> tuple[bool, float, float, float, int]:
    """The first landing after the start of a segment: ``(landed, time, phase, impact speed, flag)``.

    Where it ``stops`` the segment is a fall, and ends unlanded where the ball stands still before; else it goes on. The
    phase is in the period of ``edge`` (`model.flight.branches.fill_edges`). Each branch before is proven free of roots.
    """
    if n_windows == 0:
        return _fall_for_ever(tones, gamma, segment)
    phi0, level = segment.phase, segment.pull
    highest = 0.0
    for j in range(tones.shape[0]):
        highest += tones[j, 1]
    start_speed = gamma * segment.slope + segment.speed
    safe_from, safe_to = clear_times(highest, gamma, segment.s, segment.height, start_speed, level)
    if stops:  # turns are left out only where it is surely falling, too
        safe_from = max(safe_from, (segment.speed + gamma * (segment.slope + total_speed(tones))) / level)
    i = branch_of(edge, n_windows, phi0)
    lo, before, h, turns, flag = phi0, segment.speed, 0.0, 0.0, 0
    while True:
        hi, v = edge[i + 1], before
        tau, concave = hi - phi0 + turns, i % 2 == 1
        if concave or stops or before < 0.0:  # through a convex branch a rising ball goes on rising
            h, v, _ = motion(tones, gamma, segment, hi, tau)
        if concave:
            if h <= 0.0:  # begin where a parabola through the end, with its slope and the full pull, crosses zero
                guess = max(hi + 2.0 * h / (math.sqrt(max(v * v + 2.0 * level * h, 0.0)) - v), lo)
                x, speed = root_in_concave(tones, gamma, segment, turns, lo, hi, guess)
                return True, x - phi0 + turns, x, speed, flag
            # whole turns in which the plate at its highest stays below the ball: high flights pass thousands of windows
            if safe_from < tau < safe_to - TWO_PI:
                skipped = TWO_PI * math.floor((safe_to - tau) / TWO_PI)
                turns += skipped
                v -= level * skipped
        elif (stops or before < 0.0) and (h <= 0.0 or v >= 0.0):
            found, x, speed, graze = root_in_convex(tones, gamma, segment, turns, lo, hi)
            flag |= graze
            if found:
                return True, x - phi0 + turns, x, speed, flag
            if stops:
                # a fall that met no root in a convex branch stands still at the height's minimum there
                x = standstill(tones, gamma, segment, turns, lo, hi, hi, True)
                return False, x - phi0 + turns, x, 0.0, flag
        i += 1
        if i == 2 * n_windows:
            i = 0
            turns += TWO_PI
        lo, before = edge[i], v
