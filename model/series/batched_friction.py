"""Many orbits of the rough, bouncing ball at once, one gamma a lane and one stage a round.

The rule kept here: as in `model.series.batched_ideal`, of which this is the rough sister. Each round every lane (1)
walks the branches of its stage, up or falling, by tabulated edges to the first that provably holds the end of the
stage, and (2) all lanes together take a fixed number of Halley rounds, on h or on h'. Then each lane hangs, turns or
lands. Short bounces (`model.flight.short_bounce`) are flown at once; a stage that is not plain is flown by
`model.flight.friction`.
"""

from __future__ import annotations

import math

import numpy as np

from model.flight.branches import fold
from model.flight.chatter import tail_of_chatter
from model.flight.friction import (
    CHATTERED,
    HUNG,
    FrictionRestitution,
    fall,
    fill_rough_edges,
    hang,
    rebound,
    rise,
    rough_orbit,
    rough_take_off,
)
from model.flight.ideal import RESET
from model.flight.numerics import Flags, Floats, Rows, compiled
from model.flight.segment import SHORT, UNDECIDED, motion, shape, stage_from
from model.flight.short_bounce import short_bounce
from model.series.halley_iterations import (
    AT_EDGE,
    COUNT,
    FLAG,
    H0,
    LAST,
    LEVEL,
    N_DOWN,
    N_UP,
    PHI,
    PLAIN,
    PLAIN_GRAZE,
    RESETS,
    RISING,
    ROW,
    S0,
    SLOPE,
    SLOPE0,
    SPEED,
    STOPS,
    TAKE_OFF,
    TOTAL,
    TURNS,
    V0,
    H,
    S,
    V,
    X,
    bracket,
    halley_round,
    shapes,
)

LANES = 64
ROUNDS = 5


@compiled
def _store(
    whole: Rows, flights: Floats, lane: int, tau: float, speed: float, rest: float, flag: int, out: Floats, flags: Flags
) -> None:
    """Keep a finished flight, if the transient is over."""
    k = whole[COUNT, lane]
    if k >= 0:
        row = whole[ROW, lane]
        phi = flights[TAKE_OFF, lane]
        out[0, row, k] = tau
        out[1, row, k] = fold(phi, 0.0)
        out[2, row, k] = speed
        out[3, row, k] = rest
        flags[row, k] = flag | (RESET if whole[RESETS, lane] else 0)
    whole[COUNT, lane] = k + 1


@compiled
def _land_and_leave(
    tones: Floats,
    gamma: float,
    rough: FrictionRestitution,
    up: Floats,
    whole: Rows,
    flights: Floats,
    work: Floats,
    lane: int,
    landed: tuple[float, float, float, int],
    out: Floats,
    flags: Flags,
) -> None:
    """Store a landing ``(tau, phase, speed, flag)``, rebound, chatter, fly short bounces, and begin a long flight."""
    tau, phi, speed, flag = landed
    while True:
        v = rebound(rough, speed)
        rest = math.nan
        if v > 0.0:
            tail = tail_of_chatter(tones, gamma, rough, phi, v)
            if tail >= 0.0:
                rest, v = tail, 0.0
                phi += tail
                flag |= CHATTERED
        _store(whole, flights, lane, tau, speed, rest, flag, out, flags)
        if whole[COUNT, lane] >= out.shape[2]:
            return
        at, reset = rough_take_off(up[lane], whole[N_UP, lane], fold(phi, 0.0), v)
        whole[RESETS, lane] = reset
        flights[TAKE_OFF, lane], flights[SPEED, lane] = at, v
        short = False
        if v > 0.0:
            short, tau, speed = short_bounce(tones, gamma, rough, at, v)
            phi, flag = at + tau, 0
        if not short:
            _begin_flight(rough, whole, flights, work, lane)
            return


@compiled
def _begin_flight(rough: FrictionRestitution, whole: Rows, flights: Floats, work: Floats, lane: int) -> None:
    """The rising stage at a take-off."""
    work[PHI, lane], work[V0, lane] = flights[TAKE_OFF, lane], flights[SPEED, lane]
    work[H0, lane], work[LEVEL, lane] = 0.0, 1.0 + rough[0]
    flights[TOTAL, lane] = 0.0
    whole[RISING, lane], whole[FLAG, lane], whole[AT_EDGE, lane] = 1, 0, whole[RESETS, lane]


@compiled
def _turn(
    rough: FrictionRestitution,
    up: Floats,
    down: Floats,
    whole: Rows,
    flights: Floats,
    work: Floats,
    lane: int,
    tau: float,
) -> None:
    """From a standstill in mid-air: hang, then rise or fall."""
    n_up, n_down = whole[N_UP, lane], whole[N_DOWN, lane]
    rises, wait, phi, whole[AT_EDGE, lane] = hang(up[lane], n_up, down[lane], n_down, work[X, lane])
    flights[TOTAL, lane] += tau + wait
    work[V0, lane] = work[V, lane]
    if wait > 0.0:
        whole[FLAG, lane] |= HUNG
        work[V0, lane] = 0.0
    work[PHI, lane], work[H0, lane] = phi, work[H, lane]
    work[LEVEL, lane] = 1.0 + rough[0] if rises else 1.0 - rough[1]
    whole[RISING, lane] = 1 if rises else 0


@compiled
def _fly_stage(tones: Floats, gamma: float, up: Floats, down: Floats, whole: Rows, work: Floats, lane: int) -> float:
    """One stage alone, by `model.flight.friction`: its time, with X, H, V and STOPS as a round leaves them."""
    stage = stage_from(
        tones, gamma, work[PHI, lane], work[V0, lane], work[H0, lane], work[LEVEL, lane], whole[AT_EDGE, lane] == 1
    )
    if whole[RISING, lane]:
        tau, phi = rise(tones, gamma, up[lane], whole[N_UP, lane], stage)
        landed = False
    else:
        landed, tau, phi, _, graze = fall(tones, gamma, down[lane], whole[N_DOWN, lane], stage)
        whole[FLAG, lane] |= graze
    h, v, _ = motion(tones, gamma, stage, phi, tau)
    if not landed and h <= 0.0:  # lifted by less than rounding
        whole[FLAG, lane] |= UNDECIDED
        landed, v = True, 0.0
    work[X, lane], work[H, lane], work[V, lane] = phi, h, v
    work[STOPS, lane] = 0.0 if landed else 1.0
    return tau


@compiled
def _take_row(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    rough: FrictionRestitution,
    start: tuple[float, float],
    row: int,
    up: Floats,
    down: Floats,
    whole: Rows,
    flights: Floats,
    work: Floats,
    lane: int,
) -> None:
    """Give a lane its row: the edges of both levels in ``up[0]`` and ``down[0]``, ``s`` and ``s'`` there in 1 and 2."""
    n_up, n_down = fill_rough_edges(tones, turning, gammas[row], rough, up[0, lane], down[0, lane])
    for i in range(2 * n_up + 1):
        up[1, lane, i], up[2, lane, i], _ = shape(tones, up[0, lane, i])
    for i in range(2 * n_down + 1):
        down[1, lane, i], down[2, lane, i], _ = shape(tones, down[0, lane, i])
    whole[N_UP, lane], whole[N_DOWN, lane], whole[ROW, lane] = n_up, n_down, row
    at, reset = rough_take_off(up[0, lane], n_up, start[0], start[1])
    flights[TAKE_OFF, lane], flights[SPEED, lane], whole[RESETS, lane] = at, start[1], reset
    _begin_flight(rough, whole, flights, work, lane)


@compiled
def _lanes(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    rows: Rows,
    rough: FrictionRestitution,
    start: tuple[float, float],
    n_transient: int,
    out: Floats,
    flags: Flags,
) -> None:
    """The given ``rows`` of `rough_lockstep_diagram`, all above take-off: a lane that is done takes the next row."""
    n = min(LANES, rows.shape[0])
    size = turning.shape[0] + 2
    up, down = np.zeros((3, n, size)), np.zeros((3, n, size))
    work, flights, whole = np.zeros((18, n)), np.zeros((3, n)), np.zeros((9, n), dtype=np.int64)
    gamma = np.empty(n)
    whole[COUNT] = out.shape[2]
    taken = 0
    while True:
        busy = 0
        for lane in range(n):
            if whole[COUNT, lane] >= out.shape[2] and taken < rows.shape[0]:
                gamma[lane] = gammas[rows[taken]]
                _take_row(tones, turning, gammas, rough, start, rows[taken], up, down, whole, flights, work, lane)
                whole[COUNT, lane] = -n_transient
                taken += 1
            busy += whole[COUNT, lane] < out.shape[2]
        if busy == 0:
            return
        shapes(tones, work, PHI, n)
        work[S0], work[SLOPE0] = work[S], work[SLOPE]
        bracket(tones, gamma, up, down, whole, work, n)
        for _ in range(ROUNDS):
            shapes(tones, work, X, n)
            halley_round(gamma, work, n)
        for lane in range(n):
            if whole[COUNT, lane] >= out.shape[2]:
                continue
            tau = work[X, lane] - work[PHI, lane] + work[TURNS, lane]
            low = work[STOPS, lane] > 0.5 and work[H, lane] <= PLAIN_GRAZE
            if not (whole[PLAIN, lane] and work[LAST, lane] <= 1e-6) or tau < SHORT or low:
                tau = _fly_stage(tones, gamma[lane], up[0], down[0], whole, work, lane)
            if work[STOPS, lane] > 0.5:
                _turn(rough, up[0], down[0], whole, flights, work, lane, tau)
            else:
                landed = (flights[TOTAL, lane] + tau, work[X, lane], -work[V, lane], whole[FLAG, lane])
                _land_and_leave(tones, gamma[lane], rough, up[0], whole, flights, work, lane, landed, out, flags)


@compiled
def rough_lockstep_diagram(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    rough: FrictionRestitution,
    start: tuple[float, float],
    n_transient: int,
    out: Floats,
    flags: Flags,
) -> None:
    """Fly from the plate at ``start`` (phase, relative speed) at each gamma: ``n_transient`` flights, then those kept.

    Fills ``out`` (4, len(gammas), n_keep): flight times, take-off phases in [0, 2 pi), impact speeds, and times from
    landing to rest by chatter (else NaN); and ``flags``.
    """
    up, down = np.empty(turning.shape[0] + 2), np.empty(turning.shape[0] + 2)
    flying = np.empty(gammas.shape[0], dtype=np.int64)
    n = 0
    for row in range(gammas.shape[0]):
        n_up, n_down = fill_rough_edges(tones, turning, gammas[row], rough, up, down)
        if n_up == 0 or out.shape[2] == 0:
            rough_orbit(
                tones, gammas[row], up, n_up, down, n_down, rough, start[0], start[1], n_transient,
                out[0, row], out[1, row], out[2, row], out[3, row], flags[row],
            )  # fmt: skip
        else:
            flying[n] = row
            n += 1
    if n > 0:
        _lanes(tones, turning, gammas, flying[:n], rough, start, n_transient, out, flags)
