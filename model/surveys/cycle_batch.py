"""Cycles of many parameter points in one compiled call: flights, resets, period and flight times.

The orbits are flown side by side (`model.orbits.ideal_lanes`, `model.orbits.friction_lanes`) until a threshold repeats.
One that has not closed after `FEW_FLIGHTS` and repeats itself nearly is looked for as a locked cycle by Newton; one
that does neither within `MAX_FLIGHTS` is chaotic. What that leaves open is marked, for `model.orbits.attractor`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from kernels.arrays import Floats, Integers
from kernels.borrowed import borrowed
from kernels.lanes import WIDTH
from model.flight.branches import fold
from model.flight.edge_table import FOUND, TABLE, fill_tables
from model.flight.numerics import compiled
from model.flight.segment import shape
from model.orbits import friction_cycles, friction_lanes, ideal_cycles, ideal_lanes
from model.orbits.attractor import ARRIVED, CHAOS_SHOWN, FEW_FLIGHTS, LONGEST_LOCKED, NEAR, SLOW
from model.orbits.cycles import CHATTERS, FLIGHTS, PERIOD, RESETS, nearest_turn, repeating
from model.orbits.lane_state import (
    CLOSED,
    COUNT,
    DOWN,
    DOWN_LAST,
    E0,
    E1,
    FIRST,
    FLIES,
    FULL,
    GAMMA,
    IDLE,
    LAST_PHI,
    LAST_V,
    LIMIT,
    MARKS,
    MU_DOWN,
    MU_UP,
    NUMBERS,
    PERIODS,
    PHASES,
    Q_X,
    ROW,
    S_X,
    SEEN,
    SLOPE_X,
    SPEEDS,
    STATUS,
    TAUS,
    THRESHOLDS,
    TURN,
    UP,
    UP_LAST,
    branch_rows,
    keep_branches,
    law_of_lane,
)

CHATTERING = 3  # column of the outcome: the cycle holds a completed chatter
LOCKED = 4  # it never sticks
CHAOTIC = 5
OUTCOME_SIZE = 6
OPEN = -1  # FLIGHTS of an orbit that is left to `model.orbits.attractor`
BLOCK = 512  # rows whose tables are made at once
FIRST_LOOK = 64  # flights after which a locked cycle is looked for first: many orbits have arrived by then


@compiled
def _keep_cycle(flights: Floats, marks: Integers, lane: int, whole: Integers, outcome: Integers, kept: Floats) -> None:
    """Write a cycle's outcome, and its flight times from the reset with the smallest phase on."""
    first, stop = whole[FIRST, lane], whole[COUNT, lane]
    start = first
    for k in range(first, stop):
        if marks[THRESHOLDS, lane, k] >= 0:
            outcome[RESETS] += 1
            if fold(flights[PHASES, lane, k], 0.0) < fold(flights[PHASES, lane, start], 0.0):
                start = k
        if marks[MARKS, lane, k] & CHATTERS:
            outcome[CHATTERING] = 1
    outcome[PERIOD], outcome[FLIGHTS] = whole[PERIODS, lane], stop - first
    for k in range(min(stop - first, kept.shape[0])):
        j = start + k
        kept[k] = flights[TAUS, lane, j if j < stop else j - (stop - first)]


@compiled
def _keep_chaos(flights: Floats, marks: Integers, lane: int, count: int, outcome: Integers, kept: Floats) -> None:
    """Write the last flights of an orbit that did not close."""
    outcome[CHAOTIC], outcome[PERIOD], outcome[FLIGHTS] = 1, 0, min(count, CHAOS_SHOWN)
    for k in range(count - outcome[FLIGHTS], count):
        outcome[RESETS] += marks[THRESHOLDS, lane, k] >= 0
        if k - count + outcome[FLIGHTS] < kept.shape[0]:
            kept[k - count + outcome[FLIGHTS]] = flights[TAUS, lane, k]


@compiled
def _ideal_close(tones: Floats, turning: Floats, work: Floats, lane: int, both: Floats, n: int, cycle: Floats) -> Any:
    """A locked cycle of ``n`` flights near the lane's last state: ok, periods, largest multiplier in size."""
    base, last = int(work[UP, lane]), int(work[UP_LAST, lane])
    edge = both[base : base + TABLE * (last + 1) : TABLE].copy()
    ok, _, periods, multiplier = ideal_cycles.close_cycle(
        tones, work[GAMMA, lane], edge, last // 2, work[LAST_PHI, lane], cycle[PHASES, :n], cycle[TAUS, :n]
    )
    return ok, periods, abs(multiplier)


@compiled
def _friction_close(
    tones: Floats, turning: Floats, work: Floats, lane: int, both: Floats, n: int, cycle: Floats
) -> Any:
    """As `_ideal_close`."""
    ok, periods, trace, determinant = friction_cycles.close_cycle(
        tones, turning, work[GAMMA, lane], law_of_lane(work, lane), work[LAST_PHI, lane], work[LAST_V, lane], n,
        cycle[PHASES, :n], cycle[TAUS, :n], cycle[SPEEDS, :n], cycle[3, :n],
    )  # fmt: skip
    root = 0.25 * trace * trace - determinant
    return ok, periods, math.sqrt(determinant) if root < 0.0 else 0.5 * abs(trace) + math.sqrt(root)


@compiled
def _take_row(
    tones: Floats, row: int, slot: int, gammas: Floats, laws: Floats, made: Floats, n_up: Integers, n_down: Integers,
    limit: int, both: Floats, work: Floats, whole: Integers, lane: int,
) -> None:  # fmt: skip
    """Give a lane the orbit of a row, from rest at phase 0, with the tables ``made`` in the row's ``slot``."""
    stride = made.shape[2]
    work[GAMMA, lane] = gammas[row]
    work[MU_UP, lane], work[MU_DOWN, lane] = laws[row, 0], laws[row, 1]
    work[E0, lane], work[E1, lane] = laws[row, 2], laws[row, 3]
    work[UP, lane], work[UP_LAST, lane] = lane * stride, 2 * n_up[slot]
    work[DOWN, lane], work[DOWN_LAST, lane] = (WIDTH + lane) * stride, 2 * n_down[slot]
    for k in range(stride):
        both[lane * stride + k], both[(WIDTH + lane) * stride + k] = made[0, slot, k], made[1, slot, k]
    work[LAST_PHI, lane], work[LAST_V, lane] = fold(0.0, made[0, slot, 0]), 0.0
    work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane] = shape(tones, work[LAST_PHI, lane])
    whole[ROW, lane], whole[LIMIT, lane] = row, limit
    whole[COUNT, lane] = whole[TURN, lane] = 0
    for k in range(SEEN, whole.shape[0]):
        whole[k, lane] = -1


def _settle_of(close: Callable[..., Any]) -> Callable[..., bool]:
    """The kernel that looks for the locked cycle that an orbit has reached; ``close`` is Newton's method."""

    @compiled
    def settle(
        tones: Floats, turning: Floats, both: Floats, work: Floats, whole: Integers, flights: Floats, lane: int,
        cycle: Floats, outcome: Integers, kept: Floats,
    ) -> bool:  # fmt: skip
        """Whether the orbit of a lane nearly repeats itself; a locked cycle that it has reached is written."""
        count = whole[COUNT, lane]
        phases, speeds = flights[PHASES, lane], flights[SPEEDS, lane]
        near = False
        # flights of a cycle found where the orbit is not: only its doublings can be what the orbit is near
        tried, stable = 0, False
        for n in range(1, LONGEST_LOCKED + 1):
            if n == 2 * tried:
                tried = n
            elif tried > 0:
                continue
            if not repeating(phases, speeds, count, n, NEAR):
                continue
            near = True
            ok, periods, multiplier = close(tones, turning, work, lane, both, n, cycle)
            if not ok:
                continue
            if stable and abs(nearest_turn(cycle[PHASES, 0] - cycle[PHASES, n // 2])) < ARRIVED:
                break  # the double of a stable cycle is that cycle
            tried, stable = n, multiplier < 1.0
            if not stable:
                continue
            off, start = math.inf, 0
            for k in range(n):
                off = min(off, abs(fold(cycle[PHASES, k] - phases[count - 1] + math.pi, 0.0) - math.pi))
                if fold(cycle[PHASES, k], 0.0) < fold(cycle[PHASES, start], 0.0):
                    start = k
            if off < ARRIVED or (count >= FEW_FLIGHTS and multiplier > SLOW and off < NEAR):
                outcome[LOCKED], outcome[PERIOD], outcome[FLIGHTS] = 1, periods, n
                for k in range(min(n, kept.shape[0])):
                    kept[k] = cycle[TAUS, (start + k) % n]
                break
        return near

    return settle


def _finish_of(settle: Callable[..., bool]) -> Callable[..., bool]:
    """The kernel that says what became of an orbit."""

    @compiled
    def finish(
        tones: Floats, turning: Floats, both: Floats, work: Floats, whole: Integers, flights: Floats, marks: Integers,
        lane: int, cycle: Floats, closes: bool, outcome: Integers, kept: Floats,
    ) -> bool:  # fmt: skip
        """Write what became of a lane's orbit; False where it is to be flown on."""
        status, count = whole[STATUS, lane], whole[COUNT, lane]
        if status == CLOSED:
            _keep_cycle(flights, marks, lane, whole, outcome, kept)
        elif status == FULL and not closes:
            _keep_chaos(flights, marks, lane, count, outcome, kept)
        elif status == FULL:
            near = settle(tones, turning, both, work, whole, flights, lane, cycle, outcome, kept)
            if outcome[LOCKED] == 0 and count < flights.shape[2]:
                return False
            if not near:
                _keep_chaos(flights, marks, lane, count, outcome, kept)
            elif outcome[LOCKED] == 0:
                outcome[FLIGHTS] = OPEN
        else:
            outcome[FLIGHTS] = OPEN
        return True

    return finish


def _tables_of(*, both_ways: bool) -> Callable[..., None]:
    """The kernel that makes the tables of a block of rows; ``both_ways`` says that falls have a table of their own."""

    @compiled
    def make_tables(tones: Floats, turning: Floats, gammas: Floats, laws: Floats, tables: Any) -> None:
        """Fill ``made`` (2, BLOCK, numbers of a table) and the numbers of windows."""
        made, n_up, n_down, scaled, found = tables
        n = gammas.shape[0]
        padded = WIDTH * ((n + WIDTH - 1) // WIDTH)
        for k in range(n):
            scaled[k] = gammas[k] / (1.0 + laws[k, 0])
        fill_tables(tones, turning, scaled[:padded], made[0].reshape(-1), n_up, found)
        if both_ways:
            for k in range(n):
                scaled[k] = gammas[k] / (1.0 - laws[k, 1])
            fill_tables(tones, turning, scaled[:padded], made[1].reshape(-1), n_down, found)

    return make_tables


def _fly_of(
    leave: Callable[..., Any],
    advance: Callable[..., Any],
    finish: Callable[..., bool],
    make_tables: Callable[..., None],
    *,
    both_ways: bool,
) -> Callable[..., int]:
    """The kernel that flies the orbits of all rows, a lane that is done taking the next."""

    @compiled
    def fly(
        tones: Floats, turning: Floats, gammas: Floats, laws: Floats, closes: bool, outcome: Integers, kept: Floats,
        lanes: Any, tables: Any,
    ) -> int:  # fmt: skip
        """Fill ``outcome`` and ``kept``; returns the flights flown."""
        both, work, whole, flights, marks, cycle = lanes
        made, n_up, n_down, _, _ = tables
        highest = np.sum(np.abs(tones[:, 1]))
        limit = min(FIRST_LOOK, flights.shape[2]) if closes else flights.shape[2]
        taken = begun = stop = flown = 0  # rows taken; those with tables are begun .. stop - 1
        whole[STATUS] = IDLE
        while True:
            busy = 0
            for lane in range(WIDTH):
                while whole[STATUS, lane] != FLIES:
                    if whole[STATUS, lane] != IDLE:
                        r = whole[ROW, lane]
                        if not finish(
                            tones, turning, both, work, whole, flights, marks, lane, cycle, closes, outcome[r], kept[r]
                        ):
                            whole[LIMIT, lane] = min(4 * whole[LIMIT, lane], flights.shape[2])
                            leave(tones, both, closes, work, whole, flights, marks, lane)
                            continue
                        flown += whole[COUNT, lane]
                        whole[STATUS, lane] = IDLE
                    if taken == stop:
                        if stop == gammas.shape[0]:
                            break
                        begun, stop = stop, min(stop + BLOCK, gammas.shape[0])
                        make_tables(tones, turning, gammas[begun:stop], laws[begun:stop], tables)
                    slot = taken - begun
                    if n_up[slot] == 0:
                        outcome[taken, PERIOD] = 1
                    else:
                        _take_row(tones, taken, slot, gammas, laws, made, n_up, n_down, limit, both, work, whole, lane)
                        if both_ways:
                            keep_branches(both, work, lane)
                        leave(tones, both, closes, work, whole, flights, marks, lane)
                    taken += 1
                busy += whole[STATUS, lane] == FLIES
            if busy == 0:
                return flown
            advance(tones, highest, both, closes, work, whole, flights, marks)

    return fly


def _batch_of(
    leave: Callable[..., Any], advance: Callable[..., Any], close: Callable[..., Any], *, both_ways: bool
) -> Callable[..., int]:
    """The cycles of many rows of one kind of ball."""
    fly = _fly_of(leave, advance, _finish_of(_settle_of(close)), _tables_of(both_ways=both_ways), both_ways=both_ways)

    @compiled
    def fly_lent(
        tones: Floats, turning: Floats, gammas: Floats, laws: Floats, closes: bool, outcome: Integers, kept: Floats,
        lanes: Any, tables: Any,
    ) -> int:  # fmt: skip
        """`fly` with arrays whose references are not counted: its caller owns them."""
        both, work, whole, flights, marks, cycle = lanes
        made, n_up, n_down, scaled, found = tables
        return fly(
            borrowed(tones), borrowed(turning), borrowed(gammas), borrowed(laws), closes, borrowed(outcome),
            borrowed(kept), (
                borrowed(both), borrowed(work), borrowed(whole), borrowed(flights), borrowed(marks), borrowed(cycle)
            ), (borrowed(made), borrowed(n_up), borrowed(n_down), borrowed(scaled), borrowed(found)),
        )  # fmt: skip

    def cycle_batch(
        tones: Floats, turning: Floats, gammas: Floats, laws: Floats, closes: bool, most: int, outcome: Integers,
        kept: Floats,
    ) -> int:  # fmt: skip
        """Fill ``outcome`` (m, OUTCOME_SIZE; FLIGHTS -1 where the orbit is left open) and ``kept`` (m, keep).

        ``laws`` (m, 4) holds ``mu_up, mu_down, e0, e1``. Unless it ``closes``, every one of ``most`` flights is flown
        and the last are kept. Returns the flights flown.
        """
        size = turning.size + 2
        lanes = (
            np.zeros(2 * WIDTH * TABLE * size), np.zeros((NUMBERS + branch_rows(size), WIDTH)),
            np.zeros((SEEN + 2 * size, WIDTH), dtype=np.int64), np.zeros((3, WIDTH, most)),
            np.zeros((2, WIDTH, most), dtype=np.int64), np.zeros((4, LONGEST_LOCKED)),
        )  # fmt: skip
        tables = (
            np.zeros((2, BLOCK, TABLE * size)), np.zeros(BLOCK, dtype=np.int64), np.zeros(BLOCK, dtype=np.int64),
            np.ones(BLOCK), np.zeros(FOUND * size * WIDTH),
        )  # fmt: skip
        outcome[:] = 0
        kept[:] = math.nan
        return fly_lent(tones, turning, gammas, laws, closes, outcome, kept, lanes, tables)

    return cycle_batch


ideal_batch = _batch_of(ideal_lanes.leave, ideal_lanes.advance, _ideal_close, both_ways=False)
friction_batch = _batch_of(friction_lanes.leave, friction_lanes.advance, _friction_close, both_ways=True)
