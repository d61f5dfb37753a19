"""Orbits of the ideal ball from rest until they close, compiled.

The rule kept here: sticking forgets everything but the threshold, so an orbit is closed exactly when a threshold
repeats (the reset shortcut); no tolerance decides it. Where an orbit went is kept as whole numbers: the *landing index*
of a flight is the number of the branch (see `model.flight.branches`) in which it lands, counted from its take-off's
period, ``2 w`` branches a period. Two orbits with equal landing indices differ smoothly; where an index changes
something happened.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.flight.branches import TWO_PI, branch_of, fill_edges, fold, q_and_slope
from model.flight.ideal import land, next_take_off
from model.flight.numerics import Floats, compiled

Integers = NDArray[np.int64]

# columns of a signature
FLIGHTS = 0  # flights of the cycle; 0 at rest, -1 when no threshold repeated
RESETS = 1  # flights of the cycle that start at a threshold; without a cycle: resets in all flights flown
PERIOD = 2  # forcing periods of the cycle
CODE = 3  # hash of the cycle's landing indices, from its lowest threshold on
ENTRY = 4  # hash of the way into the cycle; 0 when it begins at once
SIGNATURE_SIZE = 5


@compiled
def fly_until_closed(
    tones: Floats,
    gamma: float,
    edge: Floats,
    n_windows: int,
    phi_rest: float,
    tau: Floats,
    phase: Floats,
    speed: Floats,
    landing_index: Integers,
    threshold: Integers,
) -> tuple[int, int, int]:
    """Fly from rest at ``phi_rest`` until a threshold repeats or the arrays are full.

    Parameters
    ----------
    tones, gamma, edge, n_windows
        Forcing, amplitude and table of windows (`model.flight.branches.fill_edges`), ``n_windows > 0``.
    phi_rest : float
        Where the ball is put down.
    tau, phase, speed, landing_index, threshold : arrays of equal length
        Filled, one entry a flight: flight time, folded take-off phase, impact speed, landing index, and the window at
        whose threshold the flight started from rest (-1: launched where it had landed).

    Returns
    -------
    first, stop, periods
        The cycle is flights ``first .. stop - 1`` and lasts ``periods``; ``first = -1`` when nothing repeated.
    """
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
        turns = round((phi0 + tau[k] - landing) / TWO_PI)
        landing_index[k] = 2 * n_windows * turns + branch_of(edge, n_windows, landing)
        turn += turns
    return -1, tau.shape[0], 0


@compiled
def lowest_start(threshold: Integers, first: int, stop: int) -> int:
    """The flight of a cycle that starts at its lowest threshold: the same wherever the cycle was entered."""
    start = first
    for k in range(first, stop):
        if threshold[k] >= 0 and threshold[k] < threshold[start]:
            start = k
    return start


@compiled
def hash_of(landing_index: Integers, threshold: Integers, first: int, stop: int, start: int) -> np.int64:
    """A whole number that tells the itineraries of flights ``first .. stop - 1`` apart, read round from ``start``."""
    code = np.int64(threshold[start] + 1)
    for k in range(stop - first):
        j = start + k
        if j >= stop:
            j -= stop - first
        code = code * 1000003 + landing_index[j] + 1
    return code


@compiled
def signatures(
    tones: Floats, turning: Floats, gammas: Floats, phi_rest: float, max_flights: int, out: Integers
) -> None:
    """Fill ``out`` (len(gammas), SIGNATURE_SIZE) with the signature of the orbit from rest at each gamma."""
    edge = np.empty(turning.shape[0] + 2)
    tau = np.empty(max_flights)
    phase = np.empty(max_flights)
    speed = np.empty(max_flights)
    index = np.empty(max_flights, dtype=np.int64)
    threshold = np.empty(max_flights, dtype=np.int64)
    for row in range(gammas.shape[0]):
        n_windows = fill_edges(tones, turning, gammas[row], edge)
        out[row] = 0
        if n_windows == 0:
            out[row, PERIOD] = 1
            continue
        first, stop, periods = fly_until_closed(
            tones, gammas[row], edge, n_windows, phi_rest, tau, phase, speed, index, threshold
        )
        closed = first >= 0
        for k in range(first if closed else 0, stop):
            out[row, RESETS] += threshold[k] >= 0
        out[row, FLIGHTS] = stop - first if closed else -1
        out[row, PERIOD] = periods
        if closed:
            out[row, CODE] = hash_of(index, threshold, first, stop, lowest_start(threshold, first, stop))
        if first > 0:
            out[row, ENTRY] = hash_of(index, threshold, 0, first, 0)


@compiled
def map_cycle(
    tones: Floats,
    gamma: float,
    edge: Floats,
    n_windows: int,
    phi0: float,
    n: int,
    phases: Floats,
    taus: Floats,
    landing_index: Integers,
) -> tuple[bool, float, int, float]:
    """``n`` flights from the take-off ``phi0`` without sticking: ``(ok, landing, turns, multiplier)``.

    ``ok`` is False where the ball sticks on the way (or at the end). The multiplier is the product of
    ``d landing / d take-off = -tau h''(take-off) / impact speed`` over the flights.
    """
    landing = fold(phi0, edge[0])
    multiplier = 1.0
    turn = 0
    for k in range(n):
        if branch_of(edge, n_windows, landing) % 2 == 1:
            return False, landing, turn, multiplier
        phases[k] = landing
        a0 = max(gamma * q_and_slope(tones, landing)[0] - 1.0, 0.0)
        taus[k], landing, speed, _ = land(tones, gamma, edge, n_windows, phases[k], a0, 0.0)
        if speed <= 0.0:
            return False, landing, turn, multiplier
        multiplier *= -taus[k] * a0 / speed
        turns = round((phases[k] + taus[k] - landing) / TWO_PI)
        landing_index[k] = 2 * n_windows * turns + branch_of(edge, n_windows, landing)
        turn += turns
    return branch_of(edge, n_windows, landing) % 2 == 0, landing, turn, multiplier


@compiled
def close_cycle(
    tones: Floats,
    gamma: float,
    edge: Floats,
    n_windows: int,
    guess: float,
    n: int,
    phases: Floats,
    taus: Floats,
    landing_index: Integers,
) -> tuple[bool, float, int, float]:
    """Newton for a cycle of ``n`` flights that never sticks, from a take-off phase near it.

    Returns
    -------
    ok, phase, periods, multiplier
        ``ok`` is False when Newton leaves the take-off window or does not converge.
    """
    phi = fold(guess, edge[0])
    turn = 0
    multiplier = 0.0
    for _ in range(60):
        ok, landing, turn, multiplier = map_cycle(tones, gamma, edge, n_windows, phi, n, phases, taus, landing_index)
        if not ok:
            return False, phi, turn, multiplier
        miss = landing - phi
        step = miss / (1.0 - multiplier)
        if abs(step) <= 1e-14 or miss == 0.0:
            return True, phi, turn, multiplier
        new = fold(phi + max(min(step, 0.1), -0.1), edge[0])
        if not math.isfinite(new) or branch_of(edge, n_windows, new) % 2 == 1:
            return False, phi, turn, multiplier
        phi = new
    return abs(step) < 1e-11, phi, turn, multiplier


@compiled
def _nearest_turn(angle: float) -> float:
    """``angle`` less whole turns, in [-pi, pi]."""
    return angle - TWO_PI * round(angle / TWO_PI)


@compiled
def locked_family(
    tones: Floats, turning: Floats, gamma: float, window: int, after: float, n: int
) -> tuple[bool, float, float, float, np.int64]:
    """``n`` flights that never stick, from a take-off ``after`` (>= 0, radians) the threshold of ``window``.

    Returns
    -------
    ok, miss, multiplier, half, code
        ``miss`` is landing minus take-off modulo ``2 pi``: 0 on a cycle; ``half`` is the same half-way (0 where an even
        cycle folds onto one of half its length; NaN for odd ``n``); ``code`` tells itineraries apart. Not ``ok`` where
        the ball sticks before the last landing or the window is too short.
    """
    edge = np.empty(turning.shape[0] + 2)
    n_windows = fill_edges(tones, turning, gamma, edge)
    half = math.nan
    code = np.int64(0)
    if window >= n_windows or edge[2 * window] + after >= edge[2 * window + 1]:
        return False, 0.0, 0.0, half, code
    start = fold(edge[2 * window] + after, edge[0])
    landing = start
    multiplier = 1.0
    for k in range(n):
        if k > 0 and branch_of(edge, n_windows, landing) % 2 == 1:
            return False, 0.0, 0.0, half, code
        if k > 0 and 2 * k == n:
            half = _nearest_turn(landing - start)
        phi0 = landing
        a0 = 0.0 if k == 0 and after == 0.0 else max(gamma * q_and_slope(tones, phi0)[0] - 1.0, 0.0)
        tau, landing, speed, _ = land(tones, gamma, edge, n_windows, phi0, a0, 0.0)
        if speed <= 0.0:
            return False, 0.0, 0.0, half, code
        multiplier *= -tau * a0 / speed
        turns = round((phi0 + tau - landing) / TWO_PI)
        last = 2 * n_windows * turns + (branch_of(edge, n_windows, landing) if k + 1 < n else 0)
        code = code * 1000003 + last + 1
    return True, _nearest_turn(landing - start), multiplier, half, code
