"""Orbits of the rough, bouncing ball until they close, and how a flight stretches a small shift; compiled.

The rule kept here: as in `model.orbits.ideal_cycles`, rest forgets everything but the threshold, so an orbit closes
exactly when a threshold repeats. A completed chatter is an infinity of bounces; the bounces of its run that stay in one
branch are one symbol of the itinerary, so that it does not depend on where the sum of the tail sets in.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.flight.branches import TWO_PI, branch_of, fold
from model.flight.chatter import tail_of_chatter
from model.flight.friction import (
    FrictionRestitution,
    fall,
    fill_rough_edges,
    hang,
    rebound,
    rise,
    rough_land,
    rough_take_off,
)
from model.flight.ideal import RESTS
from model.flight.numerics import Floats, compiled
from model.flight.segment import motion, stage_from
from model.orbits.ideal_cycles import CODE, ENTRY, FLIGHTS, PERIOD, RESETS, lowest_start

Integers = NDArray[np.int64]
Tangent = tuple[float, float, float, float]  # d landing/d phase, d landing/d v, d rebound/d phase, d rebound/d v
CHATTERS = 1  # column of marks: the landing ends in a completed chatter
SMALL = 2  # a bounce that lands in the branch in which it began


@compiled
def _rebound_or_rest(
    tones: Floats, gamma: float, rough: FrictionRestitution, phi: float, speed: float
) -> tuple[float, float]:
    """Speed after an impact, and 0; where a chatter begins that can be summed, 0 and the time to its end."""
    v = rebound(rough, speed)
    if v > 0.0:
        tail = tail_of_chatter(tones, gamma, rough, phi, v)
        if tail >= 0.0:
            return 0.0, tail
    return v, 0.0


@compiled
def fly_rough_until_closed(
    tones: Floats,
    gamma: float,
    up: Floats,
    n_up: int,
    down: Floats,
    n_down: int,
    rough: FrictionRestitution,
    phi: float,
    v: float,
    tau: Floats,
    phase: Floats,
    speed: Floats,
    landing_index: Integers,
    threshold: Integers,
    mark: Integers,
) -> tuple[int, int, int, float, float]:
    """Fly from the plate at ``phi`` with rebound speed ``v`` until a threshold repeats or the arrays are full.

    Fills what `model.orbits.ideal_cycles.fly_until_closed` fills, and ``mark`` (bits CHATTERS, SMALL).

    Returns
    -------
    first, stop, periods, phase, speed
        As there, and the state in which the ball was left. A ball that stays on the rod ends the orbit unclosed.
    """
    seen = np.full(n_up, -1, dtype=np.int64)
    seen_turn = np.zeros(n_up, dtype=np.int64)
    turn = 0
    for k in range(tau.shape[0] + 1):
        at = fold(phi, up[0])
        branch = branch_of(up, n_up, at)
        phi0, reset = rough_take_off(up, n_up, at, v)
        window = ((branch + 1) // 2) % n_up if reset else -1
        if reset:
            if branch == 2 * n_up - 1:
                turn += 1
            if seen[window] >= 0:
                return seen[window], k, turn - seen_turn[window], at, v
            seen[window] = k
            seen_turn[window] = turn
            branch = 2 * window
        if k == tau.shape[0]:
            break
        tau[k], phi, speed[k], flag = rough_land(tones, gamma, up, n_up, down, n_down, rough, phi0, v, reset)
        if flag & RESTS:
            return -1, k, 0, phi, 0.0
        phase[k] = phi0
        threshold[k] = window
        phi = fold(phi, up[0])
        turns = round((phi0 + tau[k] - phi) / TWO_PI)
        landing_index[k] = 2 * n_up * turns + branch_of(up, n_up, phi)
        mark[k] = SMALL if branch % 2 == 1 and landing_index[k] == branch else 0
        turn += turns
        v, tail = _rebound_or_rest(tones, gamma, rough, phi, speed[k])
        if tail > 0.0:
            mark[k] |= CHATTERS
            phi += tail
            turn += round((phi - fold(phi, up[0])) / TWO_PI)
            phi = fold(phi, up[0])
    return -1, tau.shape[0], 0, fold(phi, up[0]), v


@compiled
def rough_hash(
    landing_index: Integers, threshold: Integers, mark: Integers, first: int, stop: int, start: int
) -> tuple[int, int]:
    """``(code, flights)`` of an itinerary; a completed chatter's small bounces are left out of both."""
    code = threshold[start] + 1
    flights = 0
    pending = 0  # small bounces so far that will be left out if they end in a completed chatter
    for k in range(stop - first):
        j = start + k
        if j >= stop:
            j -= stop - first
        if mark[j] & SMALL:
            pending += 1
            if mark[j] & CHATTERS:
                pending = 0
                code = code * 1000003 + 7
            continue
        code = (code * 1000003 + pending) * 1000003 + landing_index[j] + 1
        flights += 1 + pending
        pending = 0
        if mark[j] & CHATTERS:
            code = code * 1000003 + 7
    return code, flights + pending


@compiled
def rough_signatures(
    tones: Floats, turning: Floats, gammas: Floats, rough: FrictionRestitution, max_flights: int, out: Integers
) -> None:
    """Fill ``out`` with signatures as `model.orbits.ideal_cycles.signatures` does."""
    up = np.empty(turning.shape[0] + 2)
    down = np.empty(turning.shape[0] + 2)
    tau = np.empty(max_flights)
    phase = np.empty(max_flights)
    speed = np.empty(max_flights)
    index = np.empty(max_flights, dtype=np.int64)
    threshold = np.empty(max_flights, dtype=np.int64)
    mark = np.empty(max_flights, dtype=np.int64)
    for row in range(gammas.shape[0]):
        gamma = gammas[row]
        n_up, n_down = fill_rough_edges(tones, turning, gamma, rough, up, down)
        out[row] = 0
        if n_up == 0:
            out[row, PERIOD] = 1
            continue
        first, stop, periods, _, _ = fly_rough_until_closed(
            tones, gamma, up, n_up, down, n_down, rough, 0.0, 0.0, tau, phase, speed, index, threshold, mark
        )
        closed = first >= 0
        for k in range(first if closed else 0, stop):
            out[row, RESETS] += threshold[k] >= 0
        out[row, FLIGHTS] = -1
        out[row, PERIOD] = periods
        if closed:
            start = lowest_start(threshold, first, stop)
            out[row, CODE], out[row, FLIGHTS] = rough_hash(index, threshold, mark, first, stop, start)
        if first > 0:
            out[row, ENTRY] = rough_hash(index, threshold, mark, 0, first, 0)[0]


@compiled
def rough_flight(
    tones: Floats,
    gamma: float,
    up: Floats,
    n_up: int,
    down: Floats,
    n_down: int,
    rough: FrictionRestitution,
    phi0: float,
    v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, Tangent]:
    """One flight with its tangent: ``(tau, landing phase, impact speed, tangent)``; tau is inf when it never lands.

    A shift of the take-off moves height and speed at a fixed time by ``(-v0, -h''(take-off))``, a change of ``v0`` by
    ``(0, 1)``; both then move freely. At a standstill the pull changes and the speed's shift with it, in proportion;
    hanging takes the speed's shift away, because the release does not know when the ball stopped.
    """
    at = fold(phi0, up[0])
    stage = stage_from(tones, gamma, at, v0, 0.0, 1.0 + rough[0], at_threshold)
    h_phi, w_phi, h_v, w_v = -v0, -stage[3], 0.0, 1.0
    rising = True
    total = 0.0
    for _ in range(1000):
        landed, speed = False, 0.0
        if rising:
            tau, phi = rise(tones, gamma, up, n_up, stage)
        else:
            landed, tau, phi, speed, _ = fall(tones, gamma, down, n_down, stage)
        h, _, pull = motion(tones, gamma, stage, phi, tau)
        h_phi += w_phi * tau
        h_v += w_v * tau
        total += tau
        if landed or h <= 0.0:
            if speed <= 0.0:
                return total, phi, 0.0, (math.nan, math.nan, math.nan, math.nan)
            phi_phi, phi_v = h_phi / speed, h_v / speed
            e_slope = rough[2] - 2.0 * rough[3] * speed if rough[2] > rough[3] * speed else 0.0
            return (
                total,
                phi,
                speed,
                (phi_phi, phi_v, -e_slope * (w_phi + pull * phi_phi), -e_slope * (w_v + pull * phi_v)),
            )
        rising, wait, phi, at_edge = hang(up, n_up, down, n_down, phi)
        total += wait
        stage = stage_from(tones, gamma, phi, 0.0, h, 1.0 + rough[0] if rising else 1.0 - rough[1], at_edge)
        factor = 0.0 if wait > 0.0 or pull == 0.0 else stage[3] / pull
        w_phi *= factor
        w_v *= factor
    return math.inf, phi, 0.0, (math.nan, math.nan, math.nan, math.nan)


@compiled
def rough_locked_family(
    tones: Floats, turning: Floats, gamma: float, rough: FrictionRestitution, window: int, after: float, n: int
) -> tuple[bool, float, float, float, int]:
    """`model.orbits.ideal_cycles.locked_family` of a rough ball that does not rebound."""
    up = np.empty(turning.shape[0] + 2)
    down = np.empty(turning.shape[0] + 2)
    n_up, n_down = fill_rough_edges(tones, turning, gamma, rough, up, down)
    half = math.nan
    code = 0
    if window >= n_up or up[2 * window] + after >= up[2 * window + 1]:
        return False, 0.0, 0.0, half, code
    start = fold(up[2 * window] + after, up[0])
    landing = start
    multiplier = 1.0
    for k in range(n):
        if k > 0 and branch_of(up, n_up, landing) % 2 == 1:
            return False, 0.0, 0.0, half, code
        if k > 0 and 2 * k == n:
            half = landing - start - TWO_PI * round((landing - start) / TWO_PI)
        phi0 = landing
        tau, landing, speed, tangent = rough_flight(
            tones, gamma, up, n_up, down, n_down, rough, phi0, 0.0, k == 0 and after == 0.0
        )
        if not speed > 0.0:
            return False, 0.0, 0.0, half, code
        landing = fold(landing, up[0])
        multiplier *= tangent[0]
        turns = round((phi0 + tau - landing) / TWO_PI)
        code = code * 1000003 + 2 * n_up * turns + (branch_of(up, n_up, landing) if k + 1 < n else 0) + 1
    miss = landing - start
    return True, miss - TWO_PI * round(miss / TWO_PI), multiplier, half, code


@compiled
def close_rough_cycle(
    tones: Floats,
    turning: Floats,
    gamma: float,
    rough: FrictionRestitution,
    phi: float,
    v: float,
    n: int,
    phases: Floats,
    taus: Floats,
    speeds: Floats,
    starts: Floats,
) -> tuple[bool, int, float, float]:
    """Newton for a cycle of ``n`` flights that never rests, from the state just after an impact.

    Fills take-off phases, flight times, impact speeds and take-off speeds.

    Returns
    -------
    ok, periods, trace, determinant
        The last two are those of the Jacobian of ``n`` flights.
    """
    up = np.empty(turning.shape[0] + 2)
    down = np.empty(turning.shape[0] + 2)
    n_up, n_down = fill_rough_edges(tones, turning, gamma, rough, up, down)
    a, b, c, d = 1.0, 0.0, 0.0, 1.0
    for _ in range(60):
        x, y, turn = fold(phi, up[0]), v, 0
        phi = x
        a, b, c, d = 1.0, 0.0, 0.0, 1.0
        for k in range(n):
            if y <= 0.0 and branch_of(up, n_up, x) % 2 == 1:
                return False, turn, 0.0, 0.0
            phases[k], starts[k] = x, y
            taus[k], landing, speeds[k], (p, q, r, s) = rough_flight(
                tones, gamma, up, n_up, down, n_down, rough, x, y, False
            )
            if not speeds[k] > 0.0:
                return False, turn, 0.0, 0.0
            landing = fold(landing, up[0])
            turn += round((x + taus[k] - landing) / TWO_PI)
            a, b, c, d = p * a + q * c, p * b + q * d, r * a + s * c, r * b + s * d
            x, y = landing, rebound(rough, speeds[k])
        miss, gain = x - phi, y - v
        determinant = (1.0 - a) * (1.0 - d) - b * c
        step = ((1.0 - d) * miss + b * gain) / determinant
        rise_ = (c * miss + (1.0 - a) * gain) / determinant
        if abs(step) + abs(rise_) <= 1e-13 * (1.0 + abs(v)) or (miss == 0.0 and gain == 0.0):
            return True, turn, a + d, a * d - b * c
        if not math.isfinite(step + rise_):
            return False, turn, 0.0, 0.0
        shrink = min(1.0, 0.1 / max(abs(step), abs(rise_)))
        phi += shrink * step
        v = max(v + shrink * rise_, 0.0)
    return abs(step) + abs(rise_) < 1e-10, turn, a + d, a * d - b * c
