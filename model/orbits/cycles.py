"""Orbits flown from rest until they close, for any kind of ball: the arrays they fill, and their symbolic dynamics.

Where an orbit went is kept as whole numbers. The *symbol* of a flight is the number of the branch (see
`model.flight.branches`) in which it lands, counted from its take-off's period, ``2 w`` branches a period. Two orbits
with equal symbols (one itinerary) differ smoothly; where a symbol changes, a bifurcation is passed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from kernels.arrays import Floats, Integers
from model.flight.branches import TWO_PI, branch_of, fold
from model.flight.numerics import compiled
from model.flight.records import EdgeTables, FrictionRestitution

CHATTERS = 1  # bit of a mark: the landing ends in a completed chatter
SMALL = 2  # bit of a mark: a bounce that lands in the branch in which it began

# columns of an itinerary's code
FLIGHTS = 0  # flights of the cycle; 0 at rest, -1 when no threshold repeated
RESETS = 1  # flights of the cycle that start at a threshold; without a cycle: resets in all flights flown
PERIOD = 2  # forcing periods of the cycle
CODE = 3  # hash of the cycle's symbols, from its lowest threshold on
ENTRY = 4  # hash of the way into the cycle; 0 when it begins at once
CODE_SIZE = 5
REPEATS = 8  # flights at least that must repeat themselves before a locked cycle is looked for


class Flown(NamedTuple):
    """One entry a flight: flight time, folded take-off phase, impact speed, symbol, threshold and mark.

    ``threshold`` is the window at whose threshold the flight started from rest (-1: launched where it had landed);
    ``mark`` holds the bits CHATTERS and SMALL.
    """

    tau: Floats
    phase: Floats
    speed: Floats
    symbol: Integers
    threshold: Integers
    mark: Integers

    def upto(self, n: int) -> Flown:
        """The first ``n`` flights."""
        tau, phase, speed, symbol, threshold, mark = self
        return Flown(tau[:n], phase[:n], speed[:n], symbol[:n], threshold[:n], mark[:n])


def room_for(n: int) -> Flown:
    """Arrays to be filled, for ``n`` flights."""
    numbers, integers = np.zeros((3, n)), np.zeros((3, n), dtype=np.int64)
    return Flown(numbers[0], numbers[1], numbers[2], integers[0], integers[1], integers[2])


@compiled
def code_of(flown: Flown, first: int, stop: int, start: int) -> tuple[int, int]:
    """``(hash, flights)`` of the itinerary of flights ``first .. stop - 1``, read round from ``start``.

    A completed chatter is an infinity of bounces; its small bounces are left out of both.
    """
    code = flown.threshold[start] + 1
    flights = 0
    pending = 0  # small bounces so far that will be left out if they end in a completed chatter
    for k in range(stop - first):
        j = start + k
        if j >= stop:
            j -= stop - first
        if flown.mark[j] & SMALL:
            pending += 1
            if flown.mark[j] & CHATTERS:
                pending = 0
                code = code * 1000003 + 7
            continue
        code = (code * 1000003 + pending) * 1000003 + flown.symbol[j] + 1
        flights += 1 + pending
        pending = 0
        if flown.mark[j] & CHATTERS:
            code = code * 1000003 + 7
    return code, flights + pending


@compiled
def lowest_start(threshold: Integers, first: int, stop: int) -> int:
    """The flight of a cycle that starts at its lowest threshold: the same wherever the cycle was entered."""
    start = first
    for k in range(first, stop):
        if threshold[k] >= 0 and threshold[k] < threshold[start]:
            start = k
    return start


@compiled
def nearest_turn(angle: float) -> float:
    """``angle`` less whole turns, in [-pi, pi]."""
    return angle - TWO_PI * round(angle / TWO_PI)


@compiled
def repeating(phase: Floats, speed: Floats, count: int, n: int, near: float) -> bool:
    """Whether each of the last flights lies within ``near`` of the one ``n`` before it, in phase and speed."""
    shown = max(n, REPEATS)
    if count < shown + n:
        return False
    for k in range(count - shown, count):
        if abs(nearest_turn(phase[k] - phase[k - n])) + abs(speed[k] - speed[k - n]) > near:
            return False
    return True


def itinerary_codes_of(from_rest: Callable[..., Any]) -> Callable[..., None]:
    """The kernel that codes the itineraries from rest at many gammas, for the orbits that ``from_rest`` flies."""

    @compiled
    def itinerary_codes(
        tones: Floats, turning: Floats, gammas: Floats, law: FrictionRestitution, flown: Flown, out: Integers
    ) -> None:
        """Fill ``out`` (len(gammas), CODE_SIZE)."""
        for row in range(gammas.shape[0]):
            lifts, first, stop, periods = from_rest(tones, turning, gammas[row], law, flown)
            out[row] = 0
            if not lifts:
                out[row, PERIOD] = 1
                continue
            closed = first >= 0
            for k in range(first if closed else 0, stop):
                out[row, RESETS] += flown.threshold[k] >= 0
            out[row, FLIGHTS] = -1
            out[row, PERIOD] = periods
            if closed:
                start = lowest_start(flown.threshold, first, stop)
                out[row, CODE], out[row, FLIGHTS] = code_of(flown, first, stop, start)
            if first > 0:
                out[row, ENTRY] = code_of(flown, 0, first, 0)[0]

    return itinerary_codes


def locked_family_of(tables_of: Callable[..., EdgeTables], flight: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel that flies cycles that never stick; ``flight`` gives time, landing, impact speed and slope."""

    @compiled
    def locked_family(
        tones: Floats, turning: Floats, gamma: float, law: FrictionRestitution, window: int, after: float, n: int
    ) -> tuple[bool, float, float, float, int]:
        """``n`` flights that never stick, from a take-off ``after`` (>= 0, radians) the threshold of ``window``.

        Returns
        -------
        ok, miss, multiplier, half, code
            ``miss`` is landing minus take-off modulo ``2 pi``: 0 on a cycle; ``half`` is the same half-way (0 where an
            even cycle folds onto one of half its length; NaN for odd ``n``); ``code`` tells itineraries apart. Not
            ``ok`` where the ball sticks before the last landing or the window is too short.
        """
        tables = tables_of(tones, turning, gamma, law)
        edge, n_windows = tables.up, tables.n_up
        half = math.nan
        code = 0
        if window >= n_windows or edge[2 * window] + after >= edge[2 * window + 1]:
            return False, 0.0, 0.0, half, code
        start = fold(edge[2 * window] + after, edge[0])
        landing = start
        multiplier = 1.0
        for k in range(n):
            if k > 0 and branch_of(edge, n_windows, landing) % 2 == 1:
                return False, 0.0, 0.0, half, code
            if k > 0 and 2 * k == n:
                half = nearest_turn(landing - start)
            phi0 = landing
            tau, landing, speed, slope = flight(tones, gamma, tables, law, phi0, k == 0 and after == 0.0)
            if not speed > 0.0:
                return False, 0.0, 0.0, half, code
            multiplier *= slope
            turns = round((phi0 + tau - landing) / TWO_PI)
            code = (
                code * 1000003 + 2 * n_windows * turns + (branch_of(edge, n_windows, landing) if k + 1 < n else 0) + 1
            )
        return True, nearest_turn(landing - start), multiplier, half, code

    return locked_family
