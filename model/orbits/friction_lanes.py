"""Orbits with friction and restitution side by side: as `model.orbits.friction_cycles`, an orbit a lane.

All lanes together find the end of the segment that each is on, and hang (`model.flight.friction_lanes`); what comes
between two flights (rebound, short bounces, the tail of a chatter, a threshold that repeats) is done lane by lane, and
a lane whose orbit is done takes the next.
"""

from __future__ import annotations

from kernels.lanes import WIDTH, select, spread, store
from model.flight.branch_walk import branch_at, fold_onto
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.friction import MOST_SEGMENTS, fall, rebound_or_rest, rise
from model.flight.friction_lanes import end_of_segment, hang_in_lanes
from model.flight.numerics import Floats, compiled, inlined
from model.flight.records import Segment
from model.flight.segment import motion, segment_from, shape, total_speed
from model.flight.short_bounce import short_bounce
from model.orbits.cycles import CHATTERS, Integers
from model.orbits.lane_state import (
    AT_EDGE,
    BRANCH,
    COUNT,
    DOWN,
    DOWN_LAST,
    FLIES,
    FULL,
    GAMMA,
    H0,
    LAST_PHI,
    LAST_V,
    LIMIT,
    MARKS,
    MU_DOWN,
    MU_UP,
    PHASES,
    PHI,
    PLAIN,
    Q_X,
    RISING,
    S_X,
    SEGMENTS,
    SLOPE,
    SLOPE_X,
    SPEEDS,
    STATUS,
    STOPS,
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
    edge_rows,
    law_of_lane,
    numbers,
    place_on,
    reset_at,
)


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
        short = False
        if v > 0.0:
            short, tau, speed = short_bounce(tones, work[GAMMA, lane], law_of_lane(work, lane), phi0, v)
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
            if v > 0.0:
                branch = int(branch_at(both, base, last, phi))
            work[PHI, lane], work[V0, lane], work[H0, lane], work[RISING, lane] = phi0, v, 0.0, 1.0
            work[BRANCH, lane], work[TOTAL, lane], work[AT_EDGE, lane] = branch, 0.0, 1.0 if window >= 0 else 0.0
            whole[SEGMENTS, lane], whole[STATUS, lane] = 0, FLIES
            return


@compiled
def _alone(tones: Floats, both: Floats, work: Floats, lane: int) -> None:
    """A segment that is not plain, by `model.flight.friction`; fills the lane as `fly_segments` does."""
    gamma, rises = work[GAMMA, lane], work[RISING, lane] == 1.0
    level = 1.0 + work[MU_UP, lane] if rises else 1.0 - work[MU_DOWN, lane]
    segment = segment_from(
        tones, gamma, work[PHI, lane], work[V0, lane], work[H0, lane], level, work[AT_EDGE, lane] == 1.0
    )
    base, last = int(work[UP if rises else DOWN, lane]), int(work[UP_LAST if rises else DOWN_LAST, lane])
    edge = both[base : base + TABLE * (last + 1) : TABLE].copy()
    landed = False
    if rises:
        tau, phi = rise(tones, gamma, edge, last // 2, segment)
    else:
        landed, tau, phi, _, _ = fall(tones, gamma, edge, last // 2, segment)
    h, v, _ = motion(tones, gamma, segment, phi, tau)
    if not landed and h <= 0.0:  # lifted by less than rounding
        landed, v = True, 0.0
    work[TAU, lane], work[X, lane], work[H, lane], work[V, lane] = tau, phi, h, v
    work[STOPS, lane] = 0.0 if landed else 1.0
    work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane] = shape(tones, phi)


@compiled
def fly_segments(tones: Floats, highest: float, both: Floats, work: Floats) -> None:
    """The end of the segment of every lane."""
    flat = work.reshape(-1)
    phi, gamma, rising = numbers(flat, PHI), numbers(flat, GAMMA), numbers(flat, RISING) > 0.5
    level = select(rising, 1.0 + numbers(flat, MU_UP), 1.0 - numbers(flat, MU_DOWN))
    pull = select(numbers(flat, AT_EDGE) > 0.5, 0.0, gamma * numbers(flat, Q) - level)
    segment = Segment(phi, numbers(flat, S), numbers(flat, SLOPE), pull, numbers(flat, V0), numbers(flat, H0), level)
    last = select(rising, numbers(flat, UP_LAST), numbers(flat, DOWN_LAST))
    place = (select(rising, numbers(flat, UP), numbers(flat, DOWN)), last, numbers(flat, BRANCH))
    bounds = (highest, total_speed(tones))
    tau, x, h, v, (s, slope, q), stops, plain = end_of_segment(
        tones, bounds, both, gamma, place, segment, rising, last > 0.5
    )
    store(flat, TAU * WIDTH, tau)
    store(flat, X * WIDTH, x)
    store(flat, H * WIDTH, h)
    store(flat, V * WIDTH, v)
    store(flat, S_X * WIDTH, s)
    store(flat, SLOPE_X * WIDTH, slope)
    store(flat, Q_X * WIDTH, q)
    store(flat, STOPS * WIDTH, select(stops, spread(1.0), spread(0.0)))
    store(flat, PLAIN * WIDTH, select(plain, spread(1.0), spread(0.0)))


@compiled
def turn_segments(both: Floats, work: Floats) -> None:
    """From a standstill in mid-air to the next rise or fall, hanging between, in every lane that stands still."""
    flat = work.reshape(-1)
    stops = numbers(flat, STOPS) > 0.5
    from_up, from_down = edge_rows(work)
    phi, up_last, down_last = numbers(flat, X), numbers(flat, UP_LAST), numbers(flat, DOWN_LAST)
    at, i = place_on(flat, (from_down, work.shape[0]), phi)
    at_up, k = place_on(flat, (from_up, from_down), phi)
    at = select(down_last > 0.0, at, phi)
    up, down = (numbers(flat, UP), up_last, at_up, k), (numbers(flat, DOWN), down_last, at, i)
    here = numbers(flat, S_X), numbers(flat, SLOPE_X)
    rises, wait, branch, at_edge, (phi, s, slope) = hang_in_lanes(both, up, down, here)
    total = numbers(flat, TOTAL) + numbers(flat, TAU)
    store(flat, TOTAL * WIDTH, total + select(stops, wait, 0.0))
    store(flat, PHI * WIDTH, select(stops, phi, numbers(flat, PHI)))
    store(flat, S * WIDTH, select(stops, s, numbers(flat, S)))
    store(flat, SLOPE * WIDTH, select(stops, slope, numbers(flat, SLOPE)))
    store(flat, Q * WIDTH, select(stops, numbers(flat, Q_X), numbers(flat, Q)))
    store(flat, BRANCH * WIDTH, select(stops, branch, numbers(flat, BRANCH)))
    store(flat, H0 * WIDTH, select(stops, numbers(flat, H), numbers(flat, H0)))
    store(flat, V0 * WIDTH, select(stops, select(wait > 0.0, 0.0, numbers(flat, V)), numbers(flat, V0)))
    store(flat, RISING * WIDTH, select(stops, select(rises, spread(1.0), spread(0.0)), numbers(flat, RISING)))
    store(flat, AT_EDGE * WIDTH, select(at_edge, spread(1.0), spread(0.0)))


@compiled
def advance(
    tones: Floats, highest: float, both: Floats, closes: bool, work: Floats, whole: Integers, flights: Floats,
    marks: Integers,
) -> None:  # fmt: skip
    """One segment of every lane that flies, and what follows its end."""
    fly_segments(tones, highest, both, work)
    for lane in range(WIDTH):
        if whole[STATUS, lane] == FLIES and work[PLAIN, lane] == 0.0:
            _alone(tones, both, work, lane)
    turn_segments(both, work)
    for lane in range(WIDTH):
        if whole[STATUS, lane] != FLIES:
            continue
        if work[STOPS, lane] == 1.0:
            whole[SEGMENTS, lane] += 1
            if whole[SEGMENTS, lane] == MOST_SEGMENTS:
                whole[STATUS, lane] = STUCK
        else:
            speed = max(-work[V, lane], 0.0)
            work[LAST_PHI, lane], work[LAST_V, lane] = _land(
                tones, both, work, whole, flights, marks, lane, work[TOTAL, lane], work[X, lane], speed
            )
            leave(tones, both, closes, work, whole, flights, marks, lane)
