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

from kernels.lanes import WIDTH
from model.flight.branches import fold
from model.flight.edge_table import TABLE, fill_tables
from model.flight.numerics import Floats, compiled
from model.orbits import friction_cycles, friction_lanes, ideal_cycles, ideal_lanes
from model.orbits.attractor import ARRIVED, CHAOS_SHOWN, FEW_FLIGHTS, LONGEST_LOCKED, NEAR, SLOW
from model.orbits.cycles import CHATTERS, FLIGHTS, PERIOD, RESETS, Integers, nearest_turn, repeating
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
    ROW,
    SEEN,
    SEGMENTS,
    SPEEDS,
    STATUS,
    TAUS,
    THRESHOLDS,
    TURN,
    UP,
    UP_LAST,
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
    row: int, gammas: Floats, laws: Floats, both: Floats, n_up: Integers, n_down: Integers, stride: int, limit: int,
    work: Floats, whole: Integers, lane: int,
) -> None:  # fmt: skip
    """Give a lane the orbit of a row, from rest at phase 0."""
    work[GAMMA, lane] = gammas[row]
    work[MU_UP, lane], work[MU_DOWN, lane] = laws[row, 0], laws[row, 1]
    work[E0, lane], work[E1, lane] = laws[row, 2], laws[row, 3]
    work[UP, lane], work[UP_LAST, lane] = row * stride, 2 * n_up[row]
    work[DOWN, lane], work[DOWN_LAST, lane] = (gammas.shape[0] + row) * stride, 2 * n_down[row]
    work[LAST_PHI, lane], work[LAST_V, lane] = fold(0.0, both[row * stride]), 0.0
    whole[ROW, lane], whole[LIMIT, lane] = row, limit
    whole[COUNT, lane] = whole[TURN, lane] = whole[SEGMENTS, lane] = 0
    whole[SEEN:, lane] = -1


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
        stable = False
        tried = 0  # flights of a cycle found where the orbit is not: only its doublings can be what the orbit is near
        for n in range(1, LONGEST_LOCKED + 1):
            if n == 2 * tried:
                tried = n
            elif tried > 0:
                continue
            if not repeating(phases, speeds, count, n, NEAR):
                continue
            near = True
            ok, periods, multiplier = close(tones, turning, work, lane, both, n, cycle)
            again = abs(nearest_turn(cycle[PHASES, 0] - cycle[PHASES, n // 2])) < ARRIVED and n > 1
            if ok and again and stable:
                break  # the double of a stable cycle is that cycle
            if ok:
                tried, stable = n, multiplier < 1.0
            if not ok or not multiplier < 1.0:
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


def _fly_of(leave: Callable[..., Any], advance: Callable[..., Any], finish: Callable[..., bool]) -> Callable[..., int]:
    """The kernel that flies the orbits of a block of rows, a lane that is done taking the next."""

    @compiled
    def fly_block(
        tones: Floats, turning: Floats, gammas: Floats, laws: Floats, n: int, both: Floats, n_up: Integers,
        n_down: Integers, closes: bool, outcome: Integers, kept: Floats, arrays: Any,
    ) -> int:  # fmt: skip
        """The orbits of ``n`` rows whose tables are in ``both``; returns the flights flown."""
        work, whole, flights, marks, cycle = arrays
        stride = TABLE * (turning.shape[0] + 2)
        highest = np.sum(np.abs(tones[:, 1]))
        limit = min(FIRST_LOOK, flights.shape[2]) if closes else flights.shape[2]
        taken = flown = 0
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
                    while taken < n and n_up[taken] == 0:
                        outcome[taken, PERIOD] = 1
                        taken += 1
                    if taken == n:
                        break
                    _take_row(taken, gammas, laws, both, n_up, n_down, stride, limit, work, whole, lane)
                    leave(tones, both, closes, work, whole, flights, marks, lane)
                    taken += 1
                busy += whole[STATUS, lane] == FLIES
            if busy == 0:
                return flown
            advance(tones, highest, both, closes, work, whole, flights, marks)

    return fly_block


def _batch_of(
    leave: Callable[..., Any], advance: Callable[..., Any], close: Callable[..., Any], *, both_ways: bool
) -> Callable[..., int]:
    """The kernel of one kind of ball; ``both_ways`` says that falls have a table of their own."""
    fly_block = _fly_of(leave, advance, _finish_of(_settle_of(close)))

    @compiled
    def cycle_batch(
        tones: Floats, turning: Floats, gammas: Floats, laws: Floats, closes: bool, most: int, outcome: Integers,
        kept: Floats,
    ) -> int:  # fmt: skip
        """Fill ``outcome`` (m, OUTCOME_SIZE; FLIGHTS -1 where the orbit is left open) and ``kept`` (m, keep).

        ``laws`` (m, 4) holds ``mu_up, mu_down, e0, e1``. Unless it ``closes``, every one of ``most`` flights is flown
        and the last are kept. Returns the flights flown.
        """
        size = turning.shape[0] + 2
        both, found = np.zeros(2 * BLOCK * TABLE * size), np.zeros(4 * size * WIDTH)
        n_up, n_down = np.zeros(BLOCK, dtype=np.int64), np.zeros(BLOCK, dtype=np.int64)
        gamma = np.zeros(BLOCK)
        arrays = (
            np.zeros((NUMBERS, WIDTH)), np.zeros((SEEN + 2 * size, WIDTH), dtype=np.int64), np.zeros((3, WIDTH, most)),
            np.zeros((2, WIDTH, most), dtype=np.int64), np.zeros((4, LONGEST_LOCKED)),
        )  # fmt: skip
        outcome[:] = 0
        kept[:] = math.nan
        flown = 0
        for start in range(0, gammas.shape[0], BLOCK):
            n = min(BLOCK, gammas.shape[0] - start)
            gamma[:n] = gammas[start : start + n]
            law = laws[start : start + n]
            level = np.ones(BLOCK)
            level[:n] = 1.0 + law[:, 0]
            fill_tables(tones, turning, gamma / level, both[: both.size // 2], n_up, found)
            if both_ways:
                level[:n] = 1.0 - law[:, 1]
                fill_tables(tones, turning, gamma / level, both[both.size // 2 :], n_down, found)
            stop = start + n
            flown += fly_block(
                tones, turning, gamma, law, n, both, n_up, n_down, closes, outcome[start:stop], kept[start:stop], arrays
            )
        return flown

    return cycle_batch


ideal_batch = _batch_of(ideal_lanes.leave, ideal_lanes.advance, _ideal_close, both_ways=False)
friction_batch = _batch_of(friction_lanes.leave, friction_lanes.advance, _friction_close, both_ways=True)
