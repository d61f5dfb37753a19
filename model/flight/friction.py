"""Flights with Coulomb friction and restitution, compiled: rise, hang, fall, rebound, chatter, each in closed form.

Between events no step is taken, and the events are proven first. Going up only ``h' = 0`` can end
the segment, because the height grows; falling the height is monotone, so the plate and the standstill are looked for
branch by branch; a standing ball hangs while it lies inside a window of the falling level and outside one of the rising
level. ``up`` and ``down`` are the tables of `model.flight.branches` at the levels ``1 + mu_up`` and ``1 - mu_down``.
"""

from __future__ import annotations

import math

import numpy as np

from kernels.arrays import Floats
from kernels.lanes import nearest
from model.flight.bounces import short_bounce, tail_of_chatter
from model.flight.branches import TWO_PI, branch_of, fill_edges, fold
from model.flight.ideal import RESTS
from model.flight.numerics import EdgeTables, FrictionRestitution, Segment, Tangent, compiled, inlined
from model.flight.segment import UNDECIDED, landing_or_standstill, motion, segment_from, standstill, total_speed

HUNG = 8
MOST_SEGMENTS = 100_000  # ups, hangs and falls in one flight; beyond it the ball is said to stay on the rod


@compiled
def edge_tables(tones: Floats, turning: Floats, gamma: float, law: FrictionRestitution) -> EdgeTables:
    """Tables of window edges at both pulls."""
    up, down = np.zeros(turning.shape[0] + 2), np.zeros(turning.shape[0] + 2)
    n_up = fill_edges(tones, turning, gamma / (1.0 + law.mu_up), up)
    n_down = fill_edges(tones, turning, gamma / (1.0 - law.mu_down), down)
    return EdgeTables(up, n_up, down, n_down)


@compiled
def rise(tones: Floats, gamma: float, up: Floats, n_up: int, segment: Segment) -> tuple[float, float]:
    """Time and phase at which a rising ball first stands still relative to the plate."""
    phi0, _, slope0, a0, v0, _, level = segment
    fastest = total_speed(tones)
    # the plate's speed is at most ``fastest``: before ``sure`` the ball rises, whole turns of it are skipped
    sure = max((v0 + gamma * (slope0 - fastest)) / level, 0.0)  # rising at least so long
    if n_up == 0:
        last = (v0 + gamma * (slope0 + fastest)) / level
        x = standstill(tones, gamma, segment, 0.0, phi0, phi0 + last, min(phi0 + v0 / -a0, phi0 + last), False)
        return x - phi0, x
    lo = fold(phi0 + sure, up[0])
    turns = TWO_PI * nearest((phi0 + sure - lo) / TWO_PI)
    i = branch_of(up, n_up, lo)
    while True:
        hi = up[i + 1]
        if i % 2 == 1 and motion(tones, gamma, segment, hi, hi - phi0 + turns)[1] <= 0.0:
            guess = lo + v0 / -a0 if a0 < 0.0 and lo == phi0 else 0.5 * (lo + hi)
            x = standstill(tones, gamma, segment, turns, lo, hi, guess, False)
            return x - phi0 + turns, x
        i += 1
        if i == 2 * n_up:
            i = 0
            turns += TWO_PI
        lo = up[i]


@inlined
def hang(up: Floats, n_up: int, down: Floats, n_down: int, phi: float) -> tuple[bool, float, float, bool]:
    """Next motion of a ball standing in mid-air at ``phi``: ``(rises, waiting time, phase, at a threshold)``."""
    if n_down == 0:
        return False, 0.0, phi, False
    at = fold(phi, down[0])
    i = branch_of(down, n_down, at)
    if i % 2 == 1:
        return False, 0.0, at, False
    wait = down[i + 1] - at
    if n_up > 0:
        at_up = fold(phi, up[0])
        k = branch_of(up, n_up, at_up)
        if k % 2 == 0:
            return True, 0.0, at_up, False
        if up[k + 1] - at_up < wait:
            return True, up[k + 1] - at_up, fold(up[k + 1], up[0]), True
    return False, wait, fold(down[i + 1], down[0]), True


@inlined
def _flown(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi0: float, v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, int, float, Tangent]:  # fmt: skip
    """A flight segment by segment: time, landing phase, impact speed, flag, the pull there, and shifts of the motion.

    A shift of the take-off moves height and speed at a fixed time by ``(-v0, -h''(take-off))``, a change of ``v0`` by
    ``(0, 1)``; both then move freely. At a standstill the pull changes and the speed's shift with it, in proportion;
    hanging takes the speed's shift away, because the release does not know when the ball stopped.
    """
    up, n_up, down, n_down = tables  # taken out once: reading an array out of a record counts a reference
    phi = fold(phi0, up[0]) if n_up > 0 else phi0
    rising, landed = True, False
    segment = segment_from(tones, gamma, phi, v0, 0.0, 1.0 + law.mu_up, at_threshold)
    h_phi, w_phi, h_v, w_v = -v0, -segment.acceleration, 0.0, 1.0
    total, flag, graze, speed = 0.0, 0, 0, 0.0
    for _ in range(MOST_SEGMENTS):
        if rising:
            tau, phi = rise(tones, gamma, up, n_up, segment)
        else:
            landed, tau, phi, speed, graze = landing_or_standstill(tones, gamma, down, n_down, segment, True)
            flag |= graze
        h, v, pull = motion(tones, gamma, segment, phi, tau)
        h_phi, h_v, total = h_phi + w_phi * tau, h_v + w_v * tau, total + tau
        if not landed and h <= 0.0:  # lifted by less than rounding
            landed, speed, flag = True, 0.0, flag | UNDECIDED
        if landed:
            return total, phi, speed, flag, pull, (h_phi, w_phi, h_v, w_v)
        rising, wait, phi, at_edge = hang(up, n_up, down, n_down, phi)
        if wait > 0.0:
            flag |= HUNG
            v = 0.0
        total += wait
        level = 1.0 + law.mu_up if rising else 1.0 - law.mu_down
        segment = segment_from(tones, gamma, phi, v, h, level, at_edge)  # v: what rounding left of a standstill
        # the saltation of a change of pull: the shift of the speed goes on in proportion to the new acceleration
        factor = 0.0 if wait > 0.0 or pull == 0.0 else segment.acceleration / pull
        w_phi, w_v = w_phi * factor, w_v * factor
    return math.inf, phi, 0.0, flag | RESTS, 0.0, (math.nan, math.nan, math.nan, math.nan)


@compiled
def land_with_friction(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi0: float, v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, int]:  # fmt: skip
    """One flight from the take-off at ``phi0`` with relative speed ``v0``.

    Returns tau (hanging included), landing phase (any turn), impact speed, flag; tau is inf, flag RESTS, when the ball
    stays on the rod.
    """
    if v0 > 0.0:
        short, tau, speed = short_bounce(tones, gamma, law, phi0, v0)
        if short:
            return tau, phi0 + tau, speed, 0
    tau, phi, speed, flag, _, _ = _flown(tones, gamma, tables, law, phi0, v0, at_threshold)
    return tau, phi, speed, flag


@compiled
def flight_and_tangent(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi0: float, v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, Tangent]:  # fmt: skip
    """One flight with its tangent: ``(tau, landing phase, impact speed, tangent)``; tau is inf when it never lands."""
    tau, phi, speed, _, pull, (h_phi, w_phi, h_v, w_v) = _flown(tones, gamma, tables, law, phi0, v0, at_threshold)
    if not speed > 0.0:
        return tau, phi, 0.0, (math.nan, math.nan, math.nan, math.nan)
    phi_phi, phi_v = h_phi / speed, h_v / speed
    e_slope = law.e0 - 2.0 * law.e1 * speed if law.e0 > law.e1 * speed else 0.0
    tangent = phi_phi, phi_v, -e_slope * (w_phi + pull * phi_phi), -e_slope * (w_v + pull * phi_v)
    return tau, phi, speed, tangent


@compiled
def rebound(law: FrictionRestitution, speed: float) -> float:
    """Speed after an impact at ``speed``: ``e0 - e1 speed`` of it, at least none and at most all."""
    return speed * min(max(law.e0 - law.e1 * speed, 0.0), 1.0)


@compiled
def rebound_or_rest(
    tones: Floats, gamma: float, law: FrictionRestitution, phi: float, speed: float
) -> tuple[float, float]:
    """Speed after an impact, and 0; where a chatter begins that can be summed, 0 and the time to its end."""
    v = rebound(law, speed)
    if v > 0.0:
        tail = tail_of_chatter(tones, gamma, law, phi, v)
        if tail >= 0.0:
            return 0.0, tail
    return v, 0.0
