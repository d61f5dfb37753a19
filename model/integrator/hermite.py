"""Roots of the quintic Hermite polynomial through height, velocity and acceleration at both ends of a step."""

from __future__ import annotations

from model.integrator.records import StepEnds, compiled


@compiled
def hermite5(z: float, ends: StepEnds) -> tuple[float, float]:
    """Height and velocity of the quintic at the part z in [0, 1] of the step."""
    d, h0, v0, a0, h1, v1, a1 = ends
    c0, c1, c2 = h0, v0 * d, 0.5 * a0 * d * d
    e = h1 - c0 - c1 - c2
    f = v1 * d - c1 - 2.0 * c2
    k = a1 * d * d - 2.0 * c2
    c3 = 10.0 * e - 4.0 * f + 0.5 * k
    c4 = -15.0 * e + 7.0 * f - k
    c5 = 6.0 * e - 3.0 * f + 0.5 * k
    h = c0 + z * (c1 + z * (c2 + z * (c3 + z * (c4 + z * c5))))
    v = (c1 + z * (2.0 * c2 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))) / d
    return h, v


@compiled
def crossing(level: float, lo: float, hi: float, ends: StepEnds) -> float:
    """Where in [lo, hi] the quintic crosses ``level``; its value minus level must differ in sign at the ends."""
    flo = hermite5(lo, ends)[0] - level
    for _ in range(60):
        mid = 0.5 * (lo + hi)
        fm, vm = hermite5(mid, ends)
        fm -= level
        if (fm > 0.0) == (flo > 0.0):
            lo, flo = mid, fm
        else:
            hi = mid
        if vm != 0.0:
            z = mid - fm / (vm * ends.d)
            if lo < z < hi:
                fz = hermite5(z, ends)[0] - level
                if (fz > 0.0) == (flo > 0.0):
                    lo, flo = z, fz
                else:
                    hi = z
        if hi - lo < 1e-13:
            break
    return 0.5 * (lo + hi)


@compiled
def standstill(ends: StepEnds) -> float:
    """Where in [0, 1] the quintic's velocity vanishes; the velocities at the ends differ in sign."""
    lo, hi = 0.0, 1.0
    for _ in range(44):
        z = 0.5 * (lo + hi)
        if (hermite5(z, ends)[1] > 0.0) == (ends.v1 > 0.0):
            hi = z
        else:
            lo = z
    return 0.5 * (lo + hi)


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
        z = standstill(ends)
        if hermite5(z, ends)[0] < 0.0:
            return crossing(0.0, 0.0, z, ends)
    return -1.0
