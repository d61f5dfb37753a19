"""Orbits with friction and restitution until they close, and how a flight stretches a small shift; compiled.

As in `model.orbits.ideal_cycles`, rest forgets everything but the threshold, so an orbit closes exactly when a
threshold repeats. The bounces of a chatter's run that stay in one branch are one symbol of the itinerary, so that it
does not depend on where the sum of the tail sets in.
"""

from __future__ import annotations

import math

import numpy as np

from kernels.arrays import Floats, Integers
from model.flight.branches import TWO_PI, branch_of, fold
from model.flight.friction import (
    edge_tables,
    hang,
    land_with_friction,
    next_event,
    next_segment,
    next_take_off,
    rebound,
    rebound_or_rest,
)
from model.flight.ideal import RESTS
from model.flight.numerics import compiled
from model.flight.records import EdgeTables, FrictionRestitution
from model.flight.segment import motion
from model.orbits.cycles import CHATTERS, SMALL, Flown, itinerary_codes_of, locked_family_of

Tangent = tuple[float, float, float, float]  # d landing/d phase, d landing/d v, d rebound/d phase, d rebound/d v
MOST_SEGMENTS = 1000  # of a flight whose tangent is asked for


@compiled
def fly_until_closed(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi: float, v: float, flown: Flown
) -> tuple[int, int, int, float, float]:
    """`fly_with_notes` with notes of its own."""
    notes = np.zeros((2, tables.n_up), dtype=np.int64)
    return fly_with_notes(tones, gamma, tables, law, phi, v, flown, notes)


@compiled
def fly_with_notes(
    tones: Floats,
    gamma: float,
    tables: EdgeTables,
    law: FrictionRestitution,
    phi: float,
    v: float,
    flown: Flown,
    notes: Integers,
) -> tuple[int, int, int, float, float]:
    """Fly from the plate at ``phi`` with rebound speed ``v`` until a threshold repeats or the arrays are full.

    ``notes`` (2, windows or more) is filled with the flight that left each threshold, and its turn.

    Returns
    -------
    first, stop, periods, phase, speed
        As `model.orbits.ideal_cycles.fly_until_closed`, and the state in which the ball was left. A ball that stays on
        the rod ends the orbit unclosed.
    """
    tau, phase, speed, symbol, threshold, mark = flown
    up, n_up = tables.up, tables.n_up
    for window in range(n_up):
        notes[0, window] = -1
    turn = 0
    for k in range(tau.shape[0] + 1):
        at = fold(phi, up[0])
        branch = branch_of(up, n_up, at)
        phi0, reset = next_take_off(up, n_up, at, v)
        window = ((branch + 1) // 2) % n_up if reset else -1
        if reset:
            if branch == 2 * n_up - 1:
                turn += 1
            if notes[0, window] >= 0:
                return notes[0, window], k, turn - notes[1, window], at, v
            notes[0, window] = k
            notes[1, window] = turn
            branch = 2 * window
        if k == tau.shape[0]:
            break
        tau[k], phi, speed[k], flag = land_with_friction(tones, gamma, tables, law, phi0, v, reset)
        if flag & RESTS:
            return -1, k, 0, phi, 0.0
        phase[k] = phi0
        threshold[k] = window
        phi = fold(phi, up[0])
        turns = round((phi0 + tau[k] - phi) / TWO_PI)
        symbol[k] = 2 * n_up * turns + branch_of(up, n_up, phi)
        mark[k] = SMALL if branch % 2 == 1 and symbol[k] == branch else 0
        turn += turns
        v, tail = rebound_or_rest(tones, gamma, law, phi, speed[k])
        if tail > 0.0:
            mark[k] |= CHATTERS
            phi += tail
            turn += round((phi - fold(phi, up[0])) / TWO_PI)
            phi = fold(phi, up[0])
    return -1, tau.shape[0], 0, fold(phi, up[0]), v


@compiled
def from_rest(
    tones: Floats, turning: Floats, gamma: float, law: FrictionRestitution, flown: Flown
) -> tuple[bool, int, int, int]:
    """`fly_until_closed` from rest at phase 0, after whether the plate lifts the ball at all."""
    tables = edge_tables(tones, turning, gamma, law)
    if tables.n_up == 0:
        return False, -1, 0, 0
    first, stop, periods, _, _ = fly_until_closed(tones, gamma, tables, law, 0.0, 0.0, flown)
    return True, first, stop, periods


@compiled
def _landing_tangent(law: FrictionRestitution, speed: float, pull: float, shift: Tangent) -> Tangent:
    """The tangent of a flight from the shifts of height and speed with take-off phase and speed, at a landing."""
    h_phi, w_phi, h_v, w_v = shift
    if speed <= 0.0:
        return math.nan, math.nan, math.nan, math.nan
    phi_phi, phi_v = h_phi / speed, h_v / speed
    e_slope = law.e0 - 2.0 * law.e1 * speed if law.e0 > law.e1 * speed else 0.0
    return phi_phi, phi_v, -e_slope * (w_phi + pull * phi_phi), -e_slope * (w_v + pull * phi_v)


@compiled
def flight_and_tangent(
    tones: Floats,
    gamma: float,
    tables: EdgeTables,
    law: FrictionRestitution,
    phi0: float,
    v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, Tangent]:
    """One flight with its tangent: ``(tau, landing phase, impact speed, tangent)``; tau is inf when it never lands.

    A shift of the take-off moves height and speed at a fixed time by ``(-v0, -h''(take-off))``, a change of ``v0`` by
    ``(0, 1)``; both then move freely. At a standstill the pull changes and the speed's shift with it, in proportion;
    hanging takes the speed's shift away, because the release does not know when the ball stopped.
    """
    up, n_up, down, n_down = tables
    at = fold(phi0, up[0])
    rising = True
    segment = next_segment(tones, gamma, law, rising, (at, 0.0, v0, at_threshold))
    h_phi, w_phi, h_v, w_v = -v0, -segment.acceleration, 0.0, 1.0
    total = 0.0
    for _ in range(MOST_SEGMENTS):
        landed, tau, phi, speed, _ = next_event(tones, gamma, up, n_up, down, n_down, segment, rising)
        h, _, pull = motion(tones, gamma, segment, phi, tau)
        h_phi += w_phi * tau
        h_v += w_v * tau
        total += tau
        if landed or h <= 0.0:
            speed = max(speed, 0.0)
            return total, phi, speed, _landing_tangent(law, speed, pull, (h_phi, w_phi, h_v, w_v))
        rising, wait, phi, at_edge = hang(up, n_up, down, n_down, phi)
        total += wait
        segment = next_segment(tones, gamma, law, rising, (phi, h, 0.0, at_edge))
        factor = 0.0 if wait > 0.0 or pull == 0.0 else segment.acceleration / pull
        w_phi *= factor
        w_v *= factor
    return math.inf, phi, 0.0, (math.nan, math.nan, math.nan, math.nan)


@compiled
def _flight(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi0: float, at_threshold: bool
) -> tuple[float, float, float, float]:
    """Time, folded landing and impact speed of a flight without rebound, and ``d landing / d take-off``."""
    tau, landing, speed, tangent = flight_and_tangent(tones, gamma, tables, law, phi0, 0.0, at_threshold)
    return tau, fold(landing, tables.up[0]), speed, tangent[0]


itinerary_codes = itinerary_codes_of(from_rest)
locked_family = locked_family_of(edge_tables, _flight)


@compiled
def close_cycle(
    tones: Floats,
    turning: Floats,
    gamma: float,
    law: FrictionRestitution,
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
    tables = edge_tables(tones, turning, gamma, law)
    up, n_up = tables.up, tables.n_up
    a, b, c, d = 1.0, 0.0, 0.0, 1.0
    for _ in range(60):
        x, y, turn = fold(phi, up[0]), v, 0
        phi = x
        a, b, c, d = 1.0, 0.0, 0.0, 1.0
        for k in range(n):
            if y <= 0.0 and branch_of(up, n_up, x) % 2 == 1:
                return False, turn, 0.0, 0.0
            phases[k], starts[k] = x, y
            taus[k], landing, speeds[k], (p, q, r, s) = flight_and_tangent(tones, gamma, tables, law, x, y, False)
            if not speeds[k] > 0.0:
                return False, turn, 0.0, 0.0
            landing = fold(landing, up[0])
            turn += round((x + taus[k] - landing) / TWO_PI)
            a, b, c, d = p * a + q * c, p * b + q * d, r * a + s * c, r * b + s * d
            x, y = landing, rebound(law, speeds[k])
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
