"""Orbits until they close, their symbolic dynamics and cycles that never rest: kernels made for either exact ball.

Sticking forgets everything but the threshold, so an orbit closes exactly when a threshold repeats; no tolerance decides
it. What differs between the balls is one flight, and what follows an impact (`cycles_of`).

Where an orbit went is stored as whole numbers. The *symbol* of a flight is the number of the branch (see
`model.flight.branches`) in which it lands, counted from its take-off's period, ``2 w`` branches a period. Two orbits
with equal symbols (one itinerary) differ smoothly; where a symbol changes, a bifurcation is passed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from kernels.arrays import Floats, Integers
from model.flight import friction, ideal
from model.flight.branches import TWO_PI, branch_of, fold
from model.flight.numerics import EdgeTables, FrictionRestitution, compiled

CHATTERS = 1  # bit of a mark: the landing ends in a completed chatter
SMALL = 2  # bit of a mark: a bounce that lands in the branch in which it began

# columns of an itinerary's code: flights of the cycle (0 at rest, -1 when no threshold repeated), those of them that
# start at a threshold (without a cycle: resets in all flights flown), its forcing periods, hashes of its symbols from
# its lowest threshold on and of the way into it (0 when it begins at once)
CODE_SIZE = 5
FLIGHTS, RESETS, PERIOD, CODE, ENTRY = range(CODE_SIZE)


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
    return Flown(*np.zeros((3, n)), *np.zeros((3, n), dtype=np.int64))


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
    # eight flights at least must repeat themselves: two alike may be chance
    shown = max(n, 8)
    if count < shown + n:
        return False
    for k in range(count - shown, count):
        if abs(nearest_turn(phase[k] - phase[k - n])) + abs(speed[k] - speed[k - n]) > near:
            return False
    return True


def fly_until_closed_of(flight: Callable[..., Any], after_impact: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel that flies an orbit until it closes."""

    @compiled
    def fly_until_closed(
        tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi: float, v: float, flown: Flown
    ) -> tuple[int, int, int, float, float]:
        """Fly from the plate at ``phi`` with rebound speed ``v`` until a threshold repeats or the arrays are full.

        The bounces of a chatter's run that stay in one branch are marked `SMALL`: they are one symbol of the itinerary,
        so that it does not depend on where the sum of the tail sets in. Returns first, stop, periods, phase, speed. The
        cycle is flights ``first .. stop - 1`` and lasts ``periods``; ``first = -1`` when nothing repeated. Then the
        state in which the ball was left. A ball that stays on the rod ends the orbit unclosed.
        """
        tau, phase, speed, symbol, threshold, mark = flown
        up, n_up = tables.up, tables.n_up
        left, left_turn = np.full(n_up, -1, dtype=np.int64), np.zeros(n_up, dtype=np.int64)
        phi, turn = fold(phi, up[0]), 0
        for k in range(tau.shape[0] + 1):
            branch = branch_of(up, n_up, phi)
            reset = v <= 0.0 and (branch % 2 == 1 or phi <= up[branch])  # it waits for the next threshold
            window = ((branch + 1) // 2) % n_up if reset else -1
            if reset:
                if branch == 2 * n_up - 1:
                    turn += 1
                if left[window] >= 0:
                    return left[window], k, turn - left_turn[window], phi, v
                left[window], left_turn[window] = k, turn
                branch = 2 * window
            if k == tau.shape[0]:
                break
            phi0 = up[branch] if reset else phi
            tau[k], phi, speed[k], flag = flight(tones, gamma, tables, law, phi0, v, reset)
            if flag & ideal.RESTS:
                return -1, k, 0, phi, 0.0
            phase[k], threshold[k] = phi0, window
            phi = fold(phi, up[0])
            turns = round((phi0 + tau[k] - phi) / TWO_PI)
            symbol[k] = 2 * n_up * turns + branch_of(up, n_up, phi)
            mark[k] = SMALL if branch % 2 == 1 and symbol[k] == branch else 0
            turn += turns
            v, tail = after_impact(tones, gamma, law, phi, speed[k])
            if tail > 0.0:
                mark[k] |= CHATTERS
                phi += tail
                turn += round((phi - fold(phi, up[0])) / TWO_PI)
                phi = fold(phi, up[0])
        return -1, tau.shape[0], 0, phi, v

    return fly_until_closed


def itinerary_codes_of(tables_of: Callable[..., EdgeTables], fly: Callable[..., Any]) -> Callable[..., None]:
    """The kernel that codes the itineraries from rest at many gammas, for the orbits of ``fly_until_closed``."""

    @compiled
    def itinerary_codes(
        tones: Floats, turning: Floats, gammas: Floats, law: FrictionRestitution, flown: Flown, out: Integers
    ) -> None:
        """Fill ``out`` (len(gammas), CODE_SIZE)."""
        for row in range(gammas.shape[0]):
            out[row] = 0
            tables = tables_of(tones, turning, gammas[row], law)
            if tables.n_up == 0:
                out[row, PERIOD] = 1
                continue
            first, stop, periods, _, _ = fly(tones, gammas[row], tables, law, 0.0, 0.0, flown)
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


def close_cycle_of(flight: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel that finds a cycle that never rests by Newton's method."""

    @compiled
    def close_cycle(
        tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi: float, v: float, cycle: Floats
    ) -> tuple[bool, int, float, float]:
        """Newton for a cycle of as many flights as ``cycle`` (4, n) has room for, from the state just after an impact.

        Fills its rows with flight times, take-off phases, impact speeds and take-off speeds. Returns ok, periods,
        trace, determinant. The last two are those of the Jacobian of all flights. Not ``ok`` where the ball rests on
        the way, or Newton does not converge.
        """
        taus, phases, speeds, starts = cycle
        up, n_up = tables.up, tables.n_up
        last, turn, a, b, c, d = math.inf, 0, 1.0, 0.0, 0.0, 1.0
        for _ in range(60):
            phi = fold(phi, up[0])
            x, y, turn = phi, v, 0
            a, b, c, d = 1.0, 0.0, 0.0, 1.0
            for k in range(taus.shape[0]):
                if y <= 0.0 and branch_of(up, n_up, x) % 2 == 1:
                    return False, turn, 0.0, 0.0
                phases[k], starts[k] = x, y
                taus[k], landing, speeds[k], (p, q, r, s) = flight(tones, gamma, tables, law, x, y, False)
                if not speeds[k] > 0.0:
                    return False, turn, 0.0, 0.0
                landing = fold(landing, up[0])
                turn += round((x + taus[k] - landing) / TWO_PI)
                # the Jacobian of all flights so far: the chain rule, one 2 x 2 matrix a flight
                a, b, c, d = p * a + q * c, p * b + q * d, r * a + s * c, r * b + s * d
                x, y = landing, friction.rebound(law, speeds[k])
            miss, gain = x - phi, y - v
            determinant = (1.0 - a) * (1.0 - d) - b * c
            step = ((1.0 - d) * miss + b * gain) / determinant
            faster = (c * miss + (1.0 - a) * gain) / determinant
            size = (abs(step) + abs(faster)) / (1.0 + abs(v))
            if size <= 1e-14 or (size < 1e-11 and size >= 0.25 * last):  # exact, or all but rounding gone
                return True, turn, a + d, a * d - b * c
            if not math.isfinite(size):
                return False, turn, 0.0, 0.0
            last = size
            # steps of 0.1 at most: farther out the cycle found would be another one
            shrink = min(1.0, 0.1 / max(abs(step), abs(faster)))
            phi += shrink * step
            v = max(v + shrink * faster, 0.0)
        return last < 1e-11, turn, a + d, a * d - b * c

    return close_cycle


class Cycles(NamedTuple):
    """The kernels of one kind of ball, and its tables of edges."""

    tables_of: Callable[..., EdgeTables]
    fly_until_closed: Callable[..., tuple[int, int, int, float, float]]
    itinerary_codes: Callable[..., None]
    close_cycle: Callable[..., tuple[bool, int, float, float]]


def cycles_of(
    tables_of: Callable[..., EdgeTables],
    flight: Callable[..., Any],
    flight_and_tangent: Callable[..., Any],
    after_impact: Callable[..., Any],
) -> Cycles:
    """The kernels of a ball by its tables, its flight, that with its tangent, and what follows an impact."""
    fly = fly_until_closed_of(flight, after_impact)
    return Cycles(
        tables_of,
        fly,
        itinerary_codes_of(tables_of, fly),
        close_cycle_of(flight_and_tangent),
    )


IDEAL = cycles_of(ideal.tables_of, ideal.flight, ideal.flight_and_tangent, ideal.after_impact)
FRICTION = cycles_of(
    friction.edge_tables, friction.land_with_friction, friction.flight_and_tangent, friction.rebound_or_rest
)
