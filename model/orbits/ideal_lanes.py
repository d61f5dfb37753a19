"""Ideal orbits side by side: as `model.orbits.ideal_cycles`, an orbit a lane.

All lanes together find their landings (`model.flight.ideal_lanes`); whether a ball waits for a threshold, and whether
that closes its orbit, is decided lane by lane. Decision 154.
"""

from __future__ import annotations

from kernels.arrays import Floats, Integers
from kernels.lanes import WIDTH, select, spread, store
from model.flight.branches import TWO_PI, q_and_slope
from model.flight.edge_table import TABLE
from model.flight.ideal import land
from model.flight.ideal_lanes import land_lanes
from model.flight.numerics import compiled, inlined
from model.flight.segment import shape
from model.orbits.lane_state import (
    AT_EDGE,
    BRANCH,
    COUNT,
    FLIES,
    FULL,
    GAMMA,
    LAST_PHI,
    LIMIT,
    MARKS,
    PHASES,
    PHI,
    PLAIN,
    S_X,
    SLOPE,
    SLOPE_X,
    SPEEDS,
    STATUS,
    TAU,
    TAUS,
    THRESHOLDS,
    TURN,
    UP,
    UP_LAST,
    S,
    V,
    X,
    numbers,
    reset_at,
)


@inlined
def leave(
    tones: Floats, both: Floats, closes: bool, work: Floats, whole: Integers, flights: Floats, marks: Integers,
    lane: int,
) -> None:  # fmt: skip
    """From the plate, at LAST_PHI, to the next flight; sets the lane's STATUS."""
    k = whole[COUNT, lane]
    if k == whole[LIMIT, lane]:
        whole[STATUS, lane] = FULL
        return
    phi0, window = work[LAST_PHI, lane], -1
    base, last, i = int(work[UP, lane]), int(work[UP_LAST, lane]), 0
    while i + 1 < last and phi0 >= both[base + TABLE * (i + 1)]:
        i += 1
    if i % 2 == 1 or phi0 <= both[base + TABLE * i]:
        window, phi0, repeats = reset_at(both, closes, work, whole, lane, i)
        if repeats:
            return
        i = 2 * window
        at = base + TABLE * i
        work[S, lane], work[SLOPE, lane] = both[at + 1], both[at + 2]
    else:
        work[S, lane], work[SLOPE, lane] = work[S_X, lane], work[SLOPE_X, lane]
    flights[PHASES, lane, k], marks[THRESHOLDS, lane, k], marks[MARKS, lane, k] = phi0, window, 0
    work[PHI, lane], work[BRANCH, lane], work[AT_EDGE, lane] = phi0, i, 1.0 if window >= 0 else 0.0
    whole[STATUS, lane] = FLIES


@compiled
def _alone(tones: Floats, both: Floats, work: Floats, lane: int) -> None:
    """A flight that is not plain, by `model.flight.ideal.land`."""
    gamma, phi0 = work[GAMMA, lane], work[PHI, lane]
    base, last = int(work[UP, lane]), int(work[UP_LAST, lane])
    edge = both[base : base + TABLE * (last + 1) : TABLE].copy()
    a0 = 0.0 if work[AT_EDGE, lane] == 1.0 else max(gamma * q_and_slope(tones, phi0)[0] - 1.0, 0.0)
    work[TAU, lane], work[X, lane], work[V, lane], _ = land(tones, gamma, edge, last // 2, phi0, a0, 0.0)
    work[S_X, lane], work[SLOPE_X, lane], _ = shape(tones, work[X, lane])


@compiled
def _land_all(tones: Floats, highest: float, both: Floats, work: Floats) -> None:
    """The landings of all lanes."""
    flat = work.reshape(-1)
    phi = numbers(flat, PHI)
    x, turns, speed, (s, slope), plain = land_lanes(
        tones, highest, both, numbers(flat, GAMMA), numbers(flat, UP), numbers(flat, UP_LAST), numbers(flat, BRANCH),
        phi, numbers(flat, S), numbers(flat, SLOPE),
    )  # fmt: skip
    store(flat, TAU * WIDTH, x - phi + turns)
    store(flat, X * WIDTH, x)
    store(flat, V * WIDTH, speed)
    store(flat, S_X * WIDTH, s)
    store(flat, SLOPE_X * WIDTH, slope)
    store(flat, PLAIN * WIDTH, select(plain, spread(1.0), spread(0.0)))


@compiled
def advance(
    tones: Floats, highest: float, both: Floats, closes: bool, work: Floats, whole: Integers, flights: Floats,
    marks: Integers,
) -> None:  # fmt: skip
    """One flight of every lane that flies, and what follows it."""
    _land_all(tones, highest, both, work)
    for lane in range(WIDTH):
        if whole[STATUS, lane] != FLIES:
            continue
        if work[PLAIN, lane] == 0.0:
            _alone(tones, both, work, lane)
        k, tau, landing = whole[COUNT, lane], work[TAU, lane], work[X, lane]
        flights[TAUS, lane, k], flights[SPEEDS, lane, k] = tau, work[V, lane]
        whole[TURN, lane] += round((work[PHI, lane] + tau - landing) / TWO_PI)
        whole[COUNT, lane] = k + 1
        work[LAST_PHI, lane] = landing
        leave(tones, both, closes, work, whole, flights, marks, lane)
