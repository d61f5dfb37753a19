"""Cycles of many parameter points in one compiled call: flights, resets, period and flight times.

The orbits are flown side by side (`model.orbits.ideal_lanes`, `model.orbits.friction_lanes`) until a threshold repeats.
One that has not closed after `FIRST_LOOK` flights and repeats itself nearly is looked for as a locked cycle by Newton;
one that does neither within `MAX_FLIGHTS` is chaotic. What that leaves open is marked, for `model.orbits.attractor`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from kernels.arrays import Floats, Integers
from kernels.lanes import WIDTH
from model.flight.branches import fold
from model.flight.lanes.edge_table import FOUND, TABLE, fill_tables
from model.flight.numerics import compiled
from model.flight.segment import shape
from model.orbits import friction_lanes, ideal_lanes
from model.orbits import lane_state as at
from model.orbits.attractor import ARRIVED, CHAOS_SHOWN, FEW_FLIGHTS, LONGEST_LOCKED, NEAR, SLOW
from model.orbits.cycles import CHATTERS, FLIGHTS, FRICTION, IDEAL, PERIOD, RESETS, Cycles, nearest_turn, repeating
from model.orbits.lane_state import Lanes, keep_branches, law_of_lane, room_for_lanes, tables_of_lane

OUTCOME_SIZE = 6
CHATTERING, LOCKED, CHAOTIC = range(3, OUTCOME_SIZE)  # columns of the outcome: a completed chatter; never sticks
OPEN = -1  # FLIGHTS of an orbit that is left to `model.orbits.attractor`
BLOCK = 512  # rows whose tables are made at once
FIRST_LOOK = 64  # flights after which a locked cycle is looked for first: many orbits have arrived by then


class Points(NamedTuple):
    """Parameter points, and what comes out for each.

    ``laws`` (m, 4) holds ``mu_up, mu_down, e0, e1``; ``outcome`` is (m, `OUTCOME_SIZE`), ``taus`` (m, keep) flight
    times. Unless an orbit ``closes``, all its flights are flown and the last are stored.
    """

    tones: Floats
    turning: Floats
    gammas: Floats
    laws: Floats
    closes: bool
    outcome: Integers
    taus: Floats


class Tables(NamedTuple):
    """Tables of edges of a block of rows going up and down (2, BLOCK, numbers of a table), and their windows."""

    made: Floats
    n_up: Integers
    n_down: Integers
    scaled: Floats
    found: Floats


@compiled
def _keep_cycle(lanes: Lanes, lane: int, outcome: Integers, taus: Floats) -> None:
    """Write a cycle's outcome, and its flight times from the reset with the smallest phase on."""
    whole, flights, marks = lanes.whole, lanes.flights, lanes.marks
    first, stop = whole[at.FIRST, lane], whole[at.COUNT, lane]
    start = first
    for k in range(first, stop):
        if marks[at.THRESHOLDS, lane, k] >= 0:
            outcome[RESETS] += 1
            if fold(flights[at.PHASES, lane, k], 0.0) < fold(flights[at.PHASES, lane, start], 0.0):
                start = k
        if marks[at.MARKS, lane, k] & CHATTERS:
            outcome[CHATTERING] = 1
    outcome[PERIOD], outcome[FLIGHTS] = whole[at.PERIODS, lane], stop - first
    for k in range(min(stop - first, taus.shape[0])):
        j = start + k
        taus[k] = flights[at.TAUS, lane, j if j < stop else j - (stop - first)]


@compiled
def _keep_chaos(lanes: Lanes, lane: int, outcome: Integers, taus: Floats) -> None:
    """Write the last flights of an orbit that did not close."""
    count = lanes.whole[at.COUNT, lane]
    outcome[CHAOTIC], outcome[PERIOD], outcome[FLIGHTS] = 1, 0, min(count, CHAOS_SHOWN)
    for k in range(count - outcome[FLIGHTS], count):
        outcome[RESETS] += lanes.marks[at.THRESHOLDS, lane, k] >= 0
        if k - count + outcome[FLIGHTS] < taus.shape[0]:
            taus[k - count + outcome[FLIGHTS]] = lanes.flights[at.TAUS, lane, k]


@compiled
def _take_row(points: Points, row: int, slot: int, tables: Tables, limit: int, lanes: Lanes, lane: int) -> None:
    """Give a lane the orbit of a row, from rest at phase 0, with the tables ``made`` in the row's ``slot``."""
    made, laws = tables.made, points.laws
    both, work, whole, _, _ = lanes
    stride = made.shape[2]
    work[at.GAMMA, lane] = points.gammas[row]
    work[at.MU_UP, lane], work[at.MU_DOWN, lane] = laws[row, 0], laws[row, 1]
    work[at.E0, lane], work[at.E1, lane] = laws[row, 2], laws[row, 3]
    work[at.UP, lane], work[at.UP_LAST, lane] = lane * stride, 2 * tables.n_up[slot]
    work[at.DOWN, lane], work[at.DOWN_LAST, lane] = (WIDTH + lane) * stride, 2 * tables.n_down[slot]
    for k in range(stride):
        both[lane * stride + k], both[(WIDTH + lane) * stride + k] = made[0, slot, k], made[1, slot, k]
    phi = fold(0.0, made[0, slot, 0])
    work[at.LAST_PHI, lane], work[at.LAST_V, lane] = phi, 0.0
    work[at.S_X, lane], work[at.SLOPE_X, lane], work[at.Q_X, lane] = shape(points.tones, phi)
    whole[at.ROW, lane], whole[at.LIMIT, lane] = row, limit
    whole[at.COUNT, lane] = whole[at.TURN, lane] = 0
    for k in range(at.SEEN, whole.shape[0]):
        whole[k, lane] = -1


def _settle_of(close_cycle: Callable[..., Any]) -> Callable[..., bool]:
    """The kernel that looks for the locked cycle that an orbit has reached; ``close_cycle`` is Newton's method."""

    @compiled
    def settle(tones: Floats, lanes: Lanes, lane: int, cycle: Floats, outcome: Integers, taus: Floats) -> bool:
        """Whether the orbit of a lane nearly repeats itself; a locked cycle that it has reached is written."""
        both, work, whole, flights, _ = lanes
        count, phases, speeds = whole[at.COUNT, lane], flights[at.PHASES, lane], flights[at.SPEEDS, lane]
        phi, v = work[at.LAST_PHI, lane], work[at.LAST_V, lane]
        # flights of a cycle found where the orbit is not: only its doublings can be what the orbit is near
        near, tried, stable = False, 0, False
        for n in range(1, LONGEST_LOCKED + 1):
            if n == 2 * tried:
                tried = n
            elif tried > 0:
                continue
            if not repeating(phases, speeds, count, n, NEAR):
                continue
            near = True
            tables, here = tables_of_lane(both, work, lane), cycle[:, :n]
            ok, periods, trace, determinant = close_cycle(
                tones, work[at.GAMMA, lane], tables, law_of_lane(work, lane), phi, v, here
            )
            if not ok:
                continue
            root = 0.25 * trace * trace - determinant
            multiplier = math.sqrt(determinant) if root < 0.0 else 0.5 * abs(trace) + math.sqrt(root)
            if stable and abs(nearest_turn(cycle[at.PHASES, 0] - cycle[at.PHASES, n // 2])) < ARRIVED:
                break  # the double of a stable cycle is that cycle
            tried, stable = n, multiplier < 1.0
            if not stable:
                continue
            off, start = math.inf, 0
            for k in range(n):
                off = min(off, abs(fold(cycle[at.PHASES, k] - phases[count - 1] + math.pi, 0.0) - math.pi))
                if fold(cycle[at.PHASES, k], 0.0) < fold(cycle[at.PHASES, start], 0.0):
                    start = k
            if off < ARRIVED or (count >= FEW_FLIGHTS and multiplier > SLOW and off < NEAR):
                outcome[LOCKED], outcome[PERIOD], outcome[FLIGHTS] = 1, periods, n
                for k in range(min(n, taus.shape[0])):
                    taus[k] = cycle[at.TAUS, (start + k) % n]
                break
        return near

    return settle


def _finish_of(close_cycle: Callable[..., Any]) -> Callable[..., bool]:
    """The kernel that says what became of an orbit."""
    settle = _settle_of(close_cycle)

    @compiled
    def finish(points: Points, lanes: Lanes, lane: int, cycle: Floats, outcome: Integers, taus: Floats) -> bool:
        """Write what became of a lane's orbit; False where it is to be flown on."""
        status, most = lanes.whole[at.STATUS, lane], lanes.flights.shape[2]
        if status == at.CLOSED:
            _keep_cycle(lanes, lane, outcome, taus)
        elif status == at.FULL and not points.closes:
            _keep_chaos(lanes, lane, outcome, taus)
        elif status == at.FULL:
            near = settle(points.tones, lanes, lane, cycle, outcome, taus)
            if outcome[LOCKED] == 0 and lanes.whole[at.COUNT, lane] < most:
                return False
            if not near:
                _keep_chaos(lanes, lane, outcome, taus)
            elif outcome[LOCKED] == 0:
                outcome[FLIGHTS] = OPEN
        else:
            outcome[FLIGHTS] = OPEN
        return True

    return finish


@compiled
def _make_tables(points: Points, begun: int, stop: int, tables: Tables, both_ways: bool) -> None:
    """Fill the tables of rows ``begun .. stop - 1``; ``both_ways`` says that falls have tables of their own."""
    made, n_up, n_down, scaled, found = tables
    tones, turning, gammas, laws = points.tones, points.turning, points.gammas, points.laws
    padded = WIDTH * ((stop - begun + WIDTH - 1) // WIDTH)
    for k in range(stop - begun):
        scaled[k] = gammas[begun + k] / (1.0 + laws[begun + k, 0])
    fill_tables(tones, turning, scaled[:padded], made[0].reshape(-1), n_up, found)
    if both_ways:
        for k in range(stop - begun):
            scaled[k] = gammas[begun + k] / (1.0 - laws[begun + k, 1])
        fill_tables(tones, turning, scaled[:padded], made[1].reshape(-1), n_down, found)


def _batch_of(kernels: ModuleType, cycles: Cycles, *, both_ways: bool) -> Callable[..., int]:
    """The cycles of many rows of one kind of ball, a lane that is done taking the next row."""
    leave, advance, finish = kernels.leave, kernels.advance, _finish_of(cycles.close_cycle)

    @compiled
    def fly(points: Points, highest: float, lanes: Lanes, tables: Tables, cycle: Floats) -> int:
        """Fill ``outcome`` and ``taus``; returns the flights flown."""
        tones, outcome, taus, whole, closes = points.tones, points.outcome, points.taus, lanes.whole, points.closes
        rows, most = points.gammas.shape[0], lanes.flights.shape[2]
        limit = min(FIRST_LOOK, most) if closes else most
        taken = begun = stop = flown = 0  # rows taken; those with tables are begun .. stop - 1
        while True:
            busy = 0
            for lane in range(WIDTH):
                while whole[at.STATUS, lane] != at.FLIES:
                    if whole[at.STATUS, lane] != at.IDLE:
                        r = whole[at.ROW, lane]
                        if not finish(points, lanes, lane, cycle, outcome[r], taus[r]):
                            whole[at.LIMIT, lane] = min(4 * whole[at.LIMIT, lane], most)
                            leave(tones, lanes, closes, lane)
                            continue
                        flown += whole[at.COUNT, lane]
                        whole[at.STATUS, lane] = at.IDLE
                    if taken == stop:
                        if stop == rows:
                            break
                        begun, stop = stop, min(stop + BLOCK, rows)
                        _make_tables(points, begun, stop, tables, both_ways)
                    slot = taken - begun
                    if tables.n_up[slot] == 0:
                        outcome[taken, PERIOD] = 1
                    else:
                        _take_row(points, taken, slot, tables, limit, lanes, lane)
                        if both_ways:
                            keep_branches(lanes.both, lanes.work, lane)
                        leave(tones, lanes, closes, lane)
                    taken += 1
                busy += whole[at.STATUS, lane] == at.FLIES
            if busy == 0:
                return flown
            advance(tones, highest, lanes, closes)

    @compiled
    def begin(points: Points, highest: float, lanes: Lanes, tables: Tables, cycle: Floats) -> int:
        """`fly`, which counts no references as a kernel below one: Python owns the arrays."""
        return fly(points, highest, lanes, tables, cycle)

    def cycle_batch(points: Points, most: int) -> int:
        """Fill ``outcome`` (FLIGHTS -1 where the orbit is left open) and ``taus``; returns the flights flown."""
        size = points.turning.size + 2
        windows = np.zeros((2, BLOCK), dtype=np.int64)
        made, found = np.zeros((2, BLOCK, TABLE * size)), np.zeros(FOUND * size * WIDTH)
        tables = Tables(made, windows[0], windows[1], np.ones(BLOCK), found)
        points.outcome[:] = 0
        points.taus[:] = math.nan
        highest = float(np.sum(np.abs(points.tones[:, 1])))
        return begin(points, highest, room_for_lanes(size, most), tables, np.zeros((4, LONGEST_LOCKED)))

    return cycle_batch


ideal_batch = _batch_of(ideal_lanes, IDEAL, both_ways=False)
friction_batch = _batch_of(friction_lanes, FRICTION, both_ways=True)
