"""Orbits of the ideal ball from rest until they close, and its locked cycles, compiled.

Sticking forgets everything but the threshold, so an orbit is closed exactly when a threshold repeats; no tolerance
decides it.
"""

from __future__ import annotations

import math

import numpy as np

from kernels.arrays import Floats
from model.flight.branches import TWO_PI, branch_of, fill_edges, fold, q_and_slope
from model.flight.ideal import land, next_take_off
from model.flight.numerics import compiled
from model.flight.records import EdgeTables, FrictionRestitution
from model.orbits.cycles import Flown, itinerary_codes_of, locked_family_of


@compiled
def fly_until_closed(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, phi_rest: float, flown: Flown
) -> tuple[int, int, int]:
    """Fly from rest at ``phi_rest`` until a threshold repeats or the arrays of ``flown`` are full.

    Parameters
    ----------
    tones, gamma, edge, n_windows
        Forcing, amplitude and table of windows (`model.flight.branches.fill_edges`), ``n_windows > 0``.

    Returns
    -------
    first, stop, periods
        The cycle is flights ``first .. stop - 1`` and lasts ``periods``; ``first = -1`` when nothing repeated.
    """
    tau, phase, speed, symbol, threshold, mark = flown
    seen = np.full(n_windows, -1, dtype=np.int64)
    seen_turn = np.zeros(n_windows, dtype=np.int64)
    landing = fold(phi_rest, edge[0])
    turn = 0
    for k in range(tau.shape[0] + 1):
        branch = branch_of(edge, n_windows, landing)
        phi0, a0, window, reset = next_take_off(tones, gamma, edge, n_windows, landing)
        if reset:
            if branch == 2 * n_windows - 1:
                turn += 1
            if seen[window] >= 0:
                return seen[window], k, turn - seen_turn[window]
            seen[window] = k
            seen_turn[window] = turn
        if k == tau.shape[0]:
            break
        tau[k], landing, speed[k], _ = land(tones, gamma, edge, n_windows, phi0, a0, 0.0)
        phase[k] = phi0
        threshold[k] = window if reset else -1
        mark[k] = 0
        turns = round((phi0 + tau[k] - landing) / TWO_PI)
        symbol[k] = 2 * n_windows * turns + branch_of(edge, n_windows, landing)
        turn += turns
    return -1, tau.shape[0], 0


@compiled
def map_cycle(
    tones: Floats,
    gamma: float,
    edge: Floats,
    n_windows: int,
    phi0: float,
    phases: Floats,
    taus: Floats,
) -> tuple[bool, float, int, float]:
    """Flights from the take-off ``phi0`` without sticking, as many as ``phases``: ``(ok, landing, turns, multiplier)``.

    ``ok`` is False where the ball sticks on the way (or at the end). The multiplier is the product of
    ``d landing / d take-off = -tau h''(take-off) / impact speed`` over the flights.
    """
    landing = fold(phi0, edge[0])
    multiplier = 1.0
    turn = 0
    for k in range(phases.shape[0]):
        if branch_of(edge, n_windows, landing) % 2 == 1:
            return False, landing, turn, multiplier
        phases[k] = landing
        a0 = max(gamma * q_and_slope(tones, landing)[0] - 1.0, 0.0)
        taus[k], landing, speed, _ = land(tones, gamma, edge, n_windows, phases[k], a0, 0.0)
        if speed <= 0.0:
            return False, landing, turn, multiplier
        multiplier *= -taus[k] * a0 / speed
        turn += round((phases[k] + taus[k] - landing) / TWO_PI)
    return branch_of(edge, n_windows, landing) % 2 == 0, landing, turn, multiplier


@compiled
def close_cycle(
    tones: Floats,
    gamma: float,
    edge: Floats,
    n_windows: int,
    guess: float,
    phases: Floats,
    taus: Floats,
) -> tuple[bool, float, int, float]:
    """Newton for a cycle that never sticks, of as many flights as ``phases``, from a take-off phase near it.

    Returns
    -------
    ok, phase, periods, multiplier
        ``ok`` is False when Newton leaves the take-off window or does not converge.
    """
    phi = fold(guess, edge[0])
    turn = 0
    multiplier = 0.0
    last = math.inf
    for _ in range(60):
        ok, landing, turn, multiplier = map_cycle(tones, gamma, edge, n_windows, phi, phases, taus)
        if not ok:
            return False, phi, turn, multiplier
        miss = landing - phi
        step = miss / (1.0 - multiplier)
        if abs(step) <= 1e-14 or (abs(step) < 1e-11 and abs(step) >= 0.25 * last):  # exact, or all but rounding gone
            return True, phi, turn, multiplier
        last = abs(step)
        new = fold(phi + max(min(step, 0.1), -0.1), edge[0])
        if not math.isfinite(new) or branch_of(edge, n_windows, new) % 2 == 1:
            return False, phi, turn, multiplier
        phi = new
    return abs(step) < 1e-11, phi, turn, multiplier


@compiled
def _tables(tones: Floats, turning: Floats, gamma: float, law: FrictionRestitution) -> EdgeTables:
    """The one table of the ideal ball, for both ways."""
    edge = np.zeros(turning.shape[0] + 2)
    n_windows = fill_edges(tones, turning, gamma, edge)
    return EdgeTables(edge, n_windows, edge, n_windows)


@compiled
def from_rest(
    tones: Floats, turning: Floats, gamma: float, law: FrictionRestitution, flown: Flown
) -> tuple[bool, int, int, int]:
    """`fly_until_closed` from rest at phase 0, after whether the plate lifts the ball at all."""
    tables = _tables(tones, turning, gamma, law)
    if tables.n_up == 0:
        return False, -1, 0, 0
    first, stop, periods = fly_until_closed(tones, gamma, tables.up, tables.n_up, 0.0, flown)
    return True, first, stop, periods


@compiled
def _flight(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi0: float, at_threshold: bool
) -> tuple[float, float, float, float]:
    """Time, folded landing and impact speed of a flight, and ``d landing / d take-off``."""
    a0 = 0.0 if at_threshold else max(gamma * q_and_slope(tones, phi0)[0] - 1.0, 0.0)
    tau, landing, speed, _ = land(tones, gamma, tables.up, tables.n_up, phi0, a0, 0.0)
    return tau, landing, speed, -tau * a0 / speed


itinerary_codes = itinerary_codes_of(from_rest)
locked_family = locked_family_of(_tables, _flight)
