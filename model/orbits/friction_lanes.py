"""Orbits with friction and restitution side by side: as `model.orbits.friction_cycles`, an orbit a lane.

All lanes that rise find the end of the rise together, then all that fall (`model.flight.friction_lanes`). A lane known
to land waits until there are `ENOUGH` of them, and their landings are located together. What is rare (hanging, what is
not plain) and what comes between two flights (rebound, short bounces, the tail of a chatter, a threshold that repeats)
is done lane by lane.
"""

from __future__ import annotations

from typing import Any

from kernels.arrays import Floats, Integers
from kernels.lanes import WIDTH, any_of, count, select, spread, store
from model.flight.branch_walk import branch_at, fold_onto
from model.flight.branches import TWO_PI, fold
from model.flight.edge_table import TABLE
from model.flight.friction import MOST_SEGMENTS, fall, hang, rebound_or_rest, rise
from model.flight.friction_lanes import fall_in_lanes, land_in_lanes, rise_in_lanes
from model.flight.numerics import Number, compiled, inlined
from model.flight.records import Segment
from model.flight.segment import motion, segment_from, shape
from model.flight.short_bounce import short_bounce, surely_long
from model.orbits.cycles import CHATTERS
from model.orbits.lane_state import (
    AT_EDGE,
    COUNT,
    DOWN,
    DOWN_LAST,
    FALLS,
    FLIES,
    FULL,
    GAMMA,
    H0,
    HANGS,
    LANDED,
    LANDS,
    LAST_PHI,
    LAST_V,
    LIMIT,
    MARKS,
    MOTION,
    MU_DOWN,
    MU_UP,
    PHASES,
    PHI,
    PLAIN,
    Q_X,
    RESTS,
    RISES,
    S_X,
    SEGMENTS,
    SLOPE,
    SLOPE_X,
    SPEEDS,
    STATUS,
    STUCK,
    TAU,
    TAUS,
    THRESHOLDS,
    TOTAL,
    TURN,
    UP,
    UP_LAST,
    V0,
    H,
    Q,
    S,
    V,
    X,
    law_of_lane,
    numbers,
    places_of_branches,
    reset_at,
)

ENOUGH = 8  # lanes that land, for their landings to be located together
PLAIN_PULL = 1e-9  # pulls nearer to an edge's than this are decided by the table


@inlined
def _land(
    tones: Floats, both: Floats, work: Floats, whole: Integers, flights: Floats, marks: Integers, lane: int,
    tau: float, phi: float, speed: float,
) -> tuple[float, float]:  # fmt: skip
    """Keep a landing; phase and speed after the rebound, or where its chatter has ended."""
    k = whole[COUNT, lane]
    flights[TAUS, lane, k], flights[SPEEDS, lane, k], marks[MARKS, lane, k] = tau, speed, 0
    base = work[UP, lane]
    phi = fold_onto(both, base, phi)
    turns = flights[PHASES, lane, k] + tau - phi
    v, tail = rebound_or_rest(tones, work[GAMMA, lane], law_of_lane(work, lane), phi, speed)
    if tail > 0.0:
        marks[MARKS, lane, k] = CHATTERS
        turns += phi + tail
        phi = fold_onto(both, base, phi + tail)
        turns -= phi
        work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane] = shape(tones, phi)
    whole[TURN, lane] += round(turns / TWO_PI)
    whole[COUNT, lane] = k + 1
    return phi, v


@compiled
def leave(
    tones: Floats, both: Floats, closes: bool, work: Floats, whole: Integers, flights: Floats, marks: Integers,
    lane: int,
) -> None:  # fmt: skip
    """From the plate, at LAST_PHI and LAST_V, to the next flight that is not a short bounce; sets the STATUS."""
    phi, v = work[LAST_PHI, lane], work[LAST_V, lane]
    base, last = work[UP, lane], work[UP_LAST, lane]
    known = True  # the plate's motion at phi
    work[MOTION, lane] = RESTS
    while True:
        k = whole[COUNT, lane]
        if k == whole[LIMIT, lane]:
            if not known:
                work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane] = shape(tones, phi)
            work[LAST_PHI, lane], work[LAST_V, lane] = phi, v
            whole[STATUS, lane] = FULL
            return
        phi0, window, branch = phi, -1, 0
        if v <= 0.0:
            branch = int(branch_at(both, base, last, phi))
            if branch % 2 == 1 or phi <= both[int(base) + TABLE * branch]:
                window, phi0, repeats = reset_at(both, closes, work, whole, lane, branch)
                if repeats:
                    return
                branch = 2 * window
        flights[PHASES, lane, k], marks[THRESHOLDS, lane, k] = phi0, window
        short, gamma, law = False, work[GAMMA, lane], law_of_lane(work, lane)
        if v > 0.0 and not (known and surely_long(tones, law, gamma * work[Q_X, lane], v)):
            short, tau, speed = short_bounce(tones, gamma, law, phi0, v)
        if short:
            phi, v = _land(tones, both, work, whole, flights, marks, lane, tau, phi0 + tau, speed)
            known = False
        else:
            if window >= 0:
                at = int(base) + TABLE * branch
                work[S, lane], work[SLOPE, lane] = both[at + 1], both[at + 2]
            elif known:
                work[S, lane], work[SLOPE, lane], work[Q, lane] = work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane]
            else:
                work[S, lane], work[SLOPE, lane], work[Q, lane] = shape(tones, phi)
            work[PHI, lane], work[V0, lane], work[H0, lane], work[MOTION, lane] = phi0, v, 0.0, RISES
            work[TOTAL, lane], work[AT_EDGE, lane], work[SEGMENTS, lane] = 0.0, 1.0 if window >= 0 else 0.0, 0.0
            whole[STATUS, lane] = FLIES
            return


@compiled
def _edges(both: Floats, base: int, last: int) -> Floats:
    """The edges of a table, for the kernels of one flight."""
    return both[base : base + TABLE * (last + 1) : TABLE].copy()


@compiled
def _alone(tones: Floats, both: Floats, work: Floats, lane: int) -> None:
    """A segment that is not plain, by `model.flight.friction`; fills the lane as `_rise` and `_fall` do."""
    gamma, rises = work[GAMMA, lane], work[MOTION, lane] == RISES
    level = 1.0 + work[MU_UP, lane] if rises else 1.0 - work[MU_DOWN, lane]
    base, last = int(work[UP if rises else DOWN, lane]), int(work[UP_LAST if rises else DOWN_LAST, lane])
    edge = _edges(both, base, last)
    phi0 = fold(work[PHI, lane], edge[0]) if last > 0 else work[PHI, lane]
    segment = segment_from(tones, gamma, phi0, work[V0, lane], work[H0, lane], level, work[AT_EDGE, lane] == 1.0)
    landed = False
    if rises:
        tau, phi = rise(tones, gamma, edge, last // 2, segment)
    else:
        landed, tau, phi, _, _ = fall(tones, gamma, edge, last // 2, segment)
    h, v, _ = motion(tones, gamma, segment, phi, tau)
    work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane] = shape(tones, phi)
    if landed or h <= 0.0:  # or lifted by less than rounding
        work[TAU, lane], work[X, lane], work[MOTION, lane] = tau, phi, LANDED
        work[V, lane] = v if landed else 0.0
        return
    work[PHI, lane], work[H0, lane], work[V0, lane], work[MOTION, lane] = phi, h, v, HANGS
    work[S, lane], work[SLOPE, lane], work[Q, lane] = work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane]
    work[TOTAL, lane] += tau
    work[AT_EDGE, lane] = 0.0


@compiled
def _hang(tones: Floats, both: Floats, work: Floats, lane: int) -> None:
    """From a standstill in mid-air to the next rise or fall."""
    up, down = int(work[UP, lane]), int(work[DOWN, lane])
    up_last, down_last = int(work[UP_LAST, lane]), int(work[DOWN_LAST, lane])
    rises, wait, phi, at_edge = hang(
        _edges(both, up, up_last), up_last // 2, _edges(both, down, down_last), down_last // 2, work[PHI, lane]
    )
    work[MOTION, lane], work[PHI, lane], work[AT_EDGE, lane] = RISES if rises else FALLS, phi, 1.0 if at_edge else 0.0
    work[TOTAL, lane] += wait
    if wait > 0.0:
        work[V0, lane] = 0.0
        work[S, lane], work[SLOPE, lane], work[Q, lane] = shape(tones, phi)


@inlined
def _segment(flat: Floats, gamma: Number, level: Number) -> Segment:
    """The segment under way in every lane."""
    pull = select(numbers(flat, AT_EDGE) > 0.5, 0.0, gamma * numbers(flat, Q) - level)
    return Segment(
        numbers(flat, PHI), numbers(flat, S), numbers(flat, SLOPE), pull, numbers(flat, V0), numbers(flat, H0), level
    )


@inlined
def _put(flat: Floats, name: int, mask: Any, value: Any) -> None:
    """Write ``value`` to a row where ``mask``."""
    store(flat, name * WIDTH, select(mask, value, numbers(flat, name)))


@inlined
def _turn(flat: Floats, stands: Any, at: Any, motion_after: Any) -> None:
    """Begin the next segment in the lanes that stand still ``at``: tau, phase, h, h', (s, s', q)."""
    tau, x, h, v, (s, slope, q) = at
    _put(flat, PHI, stands, x)
    _put(flat, H0, stands, h)
    _put(flat, V0, stands, v)
    _put(flat, S, stands, s)
    _put(flat, SLOPE, stands, slope)
    _put(flat, Q, stands, q)
    _put(flat, TOTAL, stands, numbers(flat, TOTAL) + tau)
    _put(flat, AT_EDGE, stands, 0.0)
    _put(flat, MOTION, stands, motion_after)


@compiled
def _rise(tones: Floats, flat: Floats, rows: tuple[int, int]) -> bool:
    """The ends of all rises; whether some lane is not plain, or hangs."""
    gamma = numbers(flat, GAMMA)
    rises = numbers(flat, MOTION) == RISES
    segment = _segment(flat, gamma, 1.0 + numbers(flat, MU_UP))
    tau, x, h, v, plate, plain = rise_in_lanes(tones, flat, rows, gamma, segment, rises)
    stands = rises & plain
    falls = gamma * plate[2] < 1.0 - numbers(flat, MU_DOWN) - PLAIN_PULL
    _turn(flat, stands, (tau, x, h, v, plate), select(falls, spread(FALLS), HANGS))
    _put(flat, SEGMENTS, rises, numbers(flat, SEGMENTS) + 1.0)
    store(flat, PLAIN * WIDTH, select(rises & ~plain, spread(0.0), 1.0))
    left: bool = any_of(rises & ~(plain & falls))
    return left


@compiled
def _fall(tones: Floats, flat: Floats, rows: tuple[int, int]) -> bool:
    """The ends of all falls, or that they land; whether some lane is not plain, hangs, or has moved for too long."""
    gamma = numbers(flat, GAMMA)
    falls = numbers(flat, MOTION) == FALLS
    segment = _segment(flat, gamma, 1.0 - numbers(flat, MU_DOWN))
    tau, x, h, v, plate, lands, plain = fall_in_lanes(tones, flat, rows, gamma, segment, falls)
    stands = falls & plain & ~lands
    rises = gamma * plate[2] > 1.0 + numbers(flat, MU_UP) + PLAIN_PULL
    _turn(flat, stands, (tau, x, h, v, plate), select(rises, spread(RISES), HANGS))
    _put(flat, MOTION, falls & lands, LANDS)
    store(flat, TAU * WIDTH, select(falls, tau, numbers(flat, TAU)))
    _put(flat, H, falls, h)
    _put(flat, Q_X, falls, plate[2])
    segments = numbers(flat, SEGMENTS) + 1.0
    _put(flat, SEGMENTS, falls, segments)
    store(flat, PLAIN * WIDTH, select(falls & ~plain, spread(0.0), 1.0))
    left: bool = any_of(falls & ~lands & (~(plain & rises) | (segments >= MOST_SEGMENTS)))
    return left


@compiled
def _locate(tones: Floats, flat: Floats, rows: tuple[int, int]) -> bool:
    """The landings of all lanes that wait for theirs; whether some lane is not plain."""
    gamma = numbers(flat, GAMMA)
    lands = numbers(flat, MOTION) == LANDS
    segment = _segment(flat, gamma, 1.0 - numbers(flat, MU_DOWN))
    stop = numbers(flat, TAU), numbers(flat, H), numbers(flat, Q_X)
    tau, x, v, (s, slope, q), plain = land_in_lanes(tones, flat, rows, gamma, segment, stop, lands)
    _put(flat, TAU, lands, tau)
    _put(flat, X, lands, x)
    _put(flat, V, lands, v)
    _put(flat, S_X, lands, s)
    _put(flat, SLOPE_X, lands, slope)
    _put(flat, Q_X, lands, q)
    _put(flat, MOTION, lands, select(plain, spread(LANDED), FALLS))
    _put(flat, PLAIN, lands, select(plain, spread(1.0), 0.0))
    left: bool = any_of(lands & ~plain)
    return left


@compiled
def _one_by_one(tones: Floats, both: Floats, work: Floats, whole: Integers) -> None:
    """What is not plain, or hangs, or has moved for too long."""
    for lane in range(WIDTH):
        if work[PLAIN, lane] == 0.0:
            work[PLAIN, lane] = 1.0
            _alone(tones, both, work, lane)
        if work[MOTION, lane] == HANGS:
            _hang(tones, both, work, lane)
        moves = work[MOTION, lane] == RISES or work[MOTION, lane] == FALLS
        if moves and work[SEGMENTS, lane] >= MOST_SEGMENTS:
            whole[STATUS, lane], work[MOTION, lane] = STUCK, RESTS


@compiled
def advance(
    tones: Floats, highest: float, both: Floats, closes: bool, work: Floats, whole: Integers, flights: Floats,
    marks: Integers,
) -> None:  # fmt: skip
    """Segments of all lanes until `ENOUGH` land, and what follows each landing."""
    flat = work.reshape(-1)
    windows, of_rises, of_falls, of_edges = places_of_branches(work)
    while True:
        if _rise(tones, flat, (of_rises, windows)):
            _one_by_one(tones, both, work, whole)
        if _fall(tones, flat, (of_falls, windows)):
            _one_by_one(tones, both, work, whole)
        state = numbers(flat, MOTION)
        if count(state >= LANDS) >= ENOUGH or not any_of((state == RISES) | (state == FALLS)):
            break
    if _locate(tones, flat, (of_edges, windows)):
        _one_by_one(tones, both, work, whole)
    for lane in range(WIDTH):
        if work[MOTION, lane] == LANDED:
            work[LAST_PHI, lane], work[LAST_V, lane] = _land(
                tones, both, work, whole, flights, marks, lane, work[TOTAL, lane] + work[TAU, lane], work[X, lane],
                max(-work[V, lane], 0.0),
            )  # fmt: skip
            leave(tones, both, closes, work, whole, flights, marks, lane)
