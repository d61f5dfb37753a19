"""Ideal flights on tones without a common period: the same proof, on a table of edges made for each flight.

The rule kept here: nothing of the flight differs from `model.flight.ideal` but where its edges come from. A flight
cannot last longer than the fall past the lowest the plate can be, so a finite stretch of edges is enough.
"""

from __future__ import annotations

import math

import numpy as np

from model.flight.branches import crossing, q_and_slope, turning_points
from model.flight.ideal import RESET, RESTS
from model.flight.numerics import Flags, Floats, compiled
from model.flight.segment import UNDECIDED, Segment, motion, root_in_concave, root_in_convex, shape

STRETCH = 20.0  # phase searched at a time for the next take-off
LONGEST_WAIT = 1e4  # phase after which a ball that was not lifted is said to rest; sin and cos are exact far beyond


@compiled
def edges_between(tones: Floats, gamma: float, start: float, stop: float) -> tuple[Floats, bool]:
    """Phases in ``(start, stop)`` where ``gamma q = 1``, ascending, and whether ``start`` is inside a window."""
    turning = turning_points(tones, start, stop)
    found = np.empty(turning.shape[0] + 1)
    count = 0
    lo = start
    inside = gamma * q_and_slope(tones, start)[0] >= 1.0
    above = inside
    for i in range(turning.shape[0] + 1):
        hi = turning[i] if i < turning.shape[0] else stop
        above_hi = gamma * q_and_slope(tones, hi)[0] >= 1.0
        if above_hi != above:
            found[count] = crossing(tones, gamma, lo, hi, above_hi)
            count += 1
        lo = hi
        above = above_hi
    return found[:count], inside


@compiled
def land_aperiodic(tones: Floats, gamma: float, phi0: float, v0: float, at_threshold: bool) -> tuple[float, float, int]:
    """``(tau, impact speed, flag)`` of the flight from ``phi0``; with ``v0 = 0`` the phase must be inside a window."""
    s0, slope0, q0 = shape(tones, phi0)
    stage: Segment = (phi0, s0, slope0, 0.0 if at_threshold else gamma * q0 - 1.0, v0, 0.0, 1.0)
    v = gamma * slope0 + v0
    longest = v + math.sqrt(v * v + 2.0 * gamma * (s0 + tones[:, 1].sum())) + 1.0
    edge, convex = edges_between(tones, gamma, phi0, phi0 + longest)
    if at_threshold:
        convex = True
        if edge.shape[0] > 0 and edge[0] - phi0 < 1e-9:  # the threshold itself, found again
            edge = edge[1:]
    lo = phi0
    slope_lo = v0
    flag = 0
    for i in range(edge.shape[0] + 1):
        hi = edge[i] if i < edge.shape[0] else phi0 + longest
        h, slope_hi, _ = motion(tones, gamma, stage, hi, hi - phi0)
        if not convex and h <= 0.0:
            x, speed = root_in_concave(tones, gamma, stage, 0.0, lo, hi, 0.5 * (lo + hi))
            return x - phi0, speed, flag
        if convex and i == 0 and h <= 0.0:  # lifted by less than rounding
            return 3.0 * (hi - phi0), 0.0, UNDECIDED
        if convex and i > 0 and slope_lo < 0.0:
            found, x, speed, graze = root_in_convex(tones, gamma, stage, 0.0, lo, hi)
            flag |= graze
            if found:
                return x - phi0, speed, flag
        lo, slope_lo = hi, slope_hi
        convex = not convex
    return longest, 0.0, UNDECIDED


@compiled
def next_take_off_aperiodic(tones: Floats, gamma: float, phi: float) -> tuple[float, bool]:
    """Where a ball at rest at ``phi`` leaves, and whether it had to wait; inf if not within `LONGEST_WAIT`."""
    if gamma * q_and_slope(tones, phi)[0] > 1.0:
        return phi, False
    start = phi
    while start < phi + LONGEST_WAIT:
        edge, inside = edges_between(tones, gamma, start, start + STRETCH)
        if inside:
            return start, True
        if edge.shape[0] > 0:
            return edge[0], True
        start += STRETCH
    return math.inf, True


@compiled
def aperiodic_diagram(
    tones: Floats,
    gammas: Floats,
    phi_rest: float,
    n_transient: int,
    taus: Floats,
    phases: Floats,
    flags: Flags,
) -> None:
    """As `model.series.batched_ideal.lockstep_diagram`, on tones without a period; ``phases`` are not folded."""
    for row in range(gammas.shape[0]):
        gamma = gammas[row]
        phi = phi_rest
        for k in range(-n_transient, taus.shape[1]):
            phi0, waited = next_take_off_aperiodic(tones, gamma, phi)
            tau, flag = 0.0, RESTS
            if math.isinf(phi0):
                phi0 = phi
            else:
                tau, _, flag = land_aperiodic(tones, gamma, phi0, 0.0, waited)
                flag |= RESET if waited else 0
                phi = phi0 + tau
            if k >= 0:
                taus[row, k] = tau
                phases[row, k] = phi0
                flags[row, k] = flag
