"""Roots of the quintic Hermite polynomial through height, velocity and acceleration at both ends of a step."""

from __future__ import annotations

from model.integrator.records import StepEnds, compiled, inlined

MOST_STEPS = 100  # of Newton's method: a grazing root is met by halves
Coefficients = tuple[float, float, float, float, float, float]
CLOSE = 1e-13  # part of a step to which a root is found


@inlined
def _coefficients(ends: StepEnds) -> Coefficients:
    """Coefficients of the quintic in the part z of the step."""
    d, h0, v0, a0, h1, v1, a1 = ends
    c0, c1, c2 = h0, v0 * d, 0.5 * a0 * d * d
    e = h1 - c0 - c1 - c2
    f = v1 * d - c1 - 2.0 * c2
    k = a1 * d * d - 2.0 * c2
    return c0, c1, c2, 10.0 * e - 4.0 * f + 0.5 * k, -15.0 * e + 7.0 * f - k, 6.0 * e - 3.0 * f + 0.5 * k


@compiled
def hermite5(z: float, ends: StepEnds) -> tuple[float, float]:
    """Height and velocity of the quintic at the part z in [0, 1] of the step."""
    c0, c1, c2, c3, c4, c5 = _coefficients(ends)
    h = c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * c5))))
    v = (c1 + z * (2.0 * c2 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))) / ends.d
    return h, v


@compiled
def crossing(level: float, lo: float, hi: float, ends: StepEnds) -> float:
    """Where in [lo, hi] the quintic crosses ``level``; its value minus level must differ in sign at the ends.

    Newton's method from where the chord crosses it, by bisection wherever it would leave the bracket.
    """
    c0, c1, c2, c3, c4, c5 = _coefficients(ends)
    c0 -= level
    below = c0 + lo * (c1 + lo * (c2 + lo * (c3 + lo * (c4 + lo * c5))))
    above = c0 + hi * (c1 + hi * (c2 + hi * (c3 + hi * (c4 + hi * c5))))
    at = lo + (hi - lo) * below / (below - above) if below != above else lo
    return _root((c0, c1, c2, c3, c4, c5), lo, hi, at, below > 0.0)


@compiled
def standstill(ends: StepEnds, hi: float) -> float:
    """Where in [0, hi] the quintic's velocity vanishes; the velocities at 0 and hi differ in sign."""
    _, c1, c2, c3, c4, c5 = _coefficients(ends)
    return _root((c1, 2.0 * c2, 3.0 * c3, 4.0 * c4, 5.0 * c5, 0.0), 0.0, hi, 0.5 * hi, ends.v0 > 0.0)


@compiled
def slowest(ends: StepEnds) -> float:
    """Where in [0, 1] the quintic's acceleration vanishes; the accelerations at the ends differ in sign."""
    _, _, c2, c3, c4, c5 = _coefficients(ends)
    return _root((2.0 * c2, 6.0 * c3, 12.0 * c4, 20.0 * c5, 0.0, 0.0), 0.0, 1.0, 0.5, ends.a0 > 0.0)


@compiled
def _root(polynomial: Coefficients, lo: float, hi: float, guess: float, positive: bool) -> float:
    """The root of a quintic in [lo, hi], where it is ``positive`` at lo: Newton from a guess, or bisection."""
    c0, c1, c2, c3, c4, c5 = polynomial
    z = guess if lo < guess < hi else 0.5 * (lo + hi)
    for _ in range(MOST_STEPS):
        f = c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * c5))))
        slope = c1 + z * (2.0 * c2 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))
        if (f > 0.0) == positive:
            lo = z
        else:
            hi = z
        on = z - f / slope if slope != 0.0 else lo
        if not lo < on < hi:
            on = 0.5 * (lo + hi)
        if abs(on - z) < CLOSE:
            return on
        z = on
    return z


@compiled
def first_standstill(ends: StepEnds, direction: float) -> float:
    """First place in (0, 1] of a step at which a motion in ``direction`` ends, or -1.

    A motion that turns and turns back inside the step counts, too: the velocities at both ends do not show it.
    """
    if ends.v1 * direction < 0.0:
        return standstill(ends, 1.0) if ends.v0 * direction > 0.0 else 1.0
    if ends.v0 * direction > 0.0 and ends.a0 * direction < 0.0 < ends.a1 * direction:
        z = slowest(ends)
        if hermite5(z, ends)[1] * direction < 0.0:
            return standstill(ends, z)
    return -1.0


@compiled
def first_touch(ends: StepEnds) -> float:
    """First place in (0, 1] of a step where the height falls below zero, or -1; a dip inside the step counts, too."""
    if ends.h1 <= 0.0:
        lo = 0.0
        if ends.h0 <= 0.0:  # the flight starts in this step: leave the plate first
            lo = 0.5
            while lo > 1e-9 and hermite5(lo, ends)[0] <= 0.0:
                lo *= 0.5
        return crossing(0.0, lo, 1.0, ends)
    if ends.v0 < 0.0 < ends.v1:
        z = standstill(ends, 1.0)
        if hermite5(z, ends)[0] < 0.0:
            return crossing(0.0, 0.0, z, ends)
    return -1.0
