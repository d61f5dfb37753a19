"""Orbits with friction and restitution side by side: as `model.orbits.friction_cycles`, an orbit a lane.

All lanes together find the end of the segment that each is on, and hang (`model.flight.friction_lanes`); what comes
between two flights (rebound, short bounces, the tail of a chatter, a threshold that repeats) is done lane by lane, and
a lane whose orbit is done takes the next.
"""

from __future__ import annotations

import numpy as np

from kernels.lanes import WIDTH, load, select, spread, store
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.friction import MOST_SEGMENTS, fall, rebound_or_rest, rise
from model.flight.friction_lanes import branch_at, end_of_segment, fold_onto, hang_in_lanes
from model.flight.numerics import Floats, compiled, inlined
from model.flight.records import FrictionRestitution, Segment
from model.flight.segment import motion, segment_from, shape, total_speed
from model.flight.short_bounce import short_bounce
from model.orbits.cycles import CHATTERS, Integers

# rows of the lanes' numbers
GAMMA, PHI, V0, H0, RISING, UP, UP_LAST, DOWN, DOWN_LAST, MU_UP, MU_DOWN, TAU, X, H, V, STOPS, PLAIN, TOTAL, E0, E1, AT_EDGE, LAST_PHI, LAST_V = range(23)
NUMBERS = 23
# rows of the lanes' whole numbers; from SEEN on, where each threshold was met, then in which turn
ROW, COUNT, TURN, SEGMENTS, STATUS, FIRST, PERIODS, SEEN = range(8)
FLIES, CLOSED, FULL, STUCK, IDLE = range(5)  # values of STATUS
TAUS, PHASES, SPEEDS = range(3)  # of the flights
THRESHOLDS, MARKS = range(2)


@inlined
def law_of_lane(work: Floats, lane: int) -> FrictionRestitution:
    """Friction and restitution of a lane."""
    return FrictionRestitution(work[MU_UP, lane], work[MU_DOWN, lane], work[E0, lane], work[E1, lane])


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
    whole[TURN, lane] += round(turns / TWO_PI)
    whole[COUNT, lane] = k + 1
    return phi, v


@inlined
def _leave(
    tones: Floats, both: Floats, closes: bool, work: Floats, whole: Integers, flights: Floats, marks: Integers,
    lane: int, phi: float, v: float,
) -> None:  # fmt: skip
    """From the plate at a phase and speed to the next flight that is not a short bounce; sets the lane's STATUS."""
    base, last = work[UP, lane], work[UP_LAST, lane]
    n_up = int(last) // 2
    while True:
        phi0, window = phi, -1
        if v <= 0.0:
            i = branch_at(both, base, last, phi)
            edge = both[int(base + TABLE * i)]
            branch = int(i)
            if branch % 2 == 1 or phi <= edge:
                window = ((branch + 1) // 2) % n_up
                phi0 = both[int(base) + TABLE * 2 * window]
                if branch == 2 * n_up - 1:
                    whole[TURN, lane] += 1
        k = whole[COUNT, lane]
        if window >= 0:
            if closes and whole[SEEN + window, lane] >= 0:
                whole[FIRST, lane] = whole[SEEN + window, lane]
                whole[PERIODS, lane] = whole[TURN, lane] - whole[SEEN + n_up + window, lane]
                whole[STATUS, lane] = CLOSED
                return
            whole[SEEN + window, lane], whole[SEEN + n_up + window, lane] = k, whole[TURN, lane]
        if k == flights.shape[2]:
            work[LAST_PHI, lane], work[LAST_V, lane] = phi, v
            whole[STATUS, lane] = FULL
            return
        flights[PHASES, lane, k], marks[THRESHOLDS, lane, k] = phi0, window
        short = False
        if v > 0.0:
            short, tau, speed = short_bounce(tones, work[GAMMA, lane], law_of_lane(work, lane), phi0, v)
        if short:
            phi, v = _land(tones, both, work, whole, flights, marks, lane, tau, phi0 + tau, speed)
        else:
            work[PHI, lane], work[V0, lane], work[H0, lane], work[RISING, lane] = phi0, v, 0.0, 1.0
            work[TOTAL, lane], work[AT_EDGE, lane] = 0.0, 1.0 if window >= 0 else 0.0
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


@inlined
def _row(flat: Floats, name: int) -> object:
    return load(flat, name * WIDTH)


@compiled
def fly_segments(tones: Floats, highest: float, both: Floats, work: Floats) -> None:
    """The end of the segment of every lane."""
    flat = work.reshape(-1)
    phi, gamma, rising = _row(flat, PHI), _row(flat, GAMMA), _row(flat, RISING) > 0.5
    s0, slope0, _ = shape(tones, phi)
    level = select(rising, 1.0 + _row(flat, MU_UP), 1.0 - _row(flat, MU_DOWN))
    segment = Segment(phi, s0, slope0, s0, _row(flat, V0), _row(flat, H0), level)
    last = select(rising, _row(flat, UP_LAST), _row(flat, DOWN_LAST))
    place = (select(rising, _row(flat, UP), _row(flat, DOWN)), last)
    bounds = (highest, total_speed(tones))
    tau, x, h, v, stops, plain = end_of_segment(tones, bounds, both, gamma, place, segment, rising, last > 0.5)
    store(flat, TAU * WIDTH, tau)
    store(flat, X * WIDTH, x)
    store(flat, H * WIDTH, h)
    store(flat, V * WIDTH, v)
    store(flat, STOPS * WIDTH, select(stops, spread(1.0), spread(0.0)))
    store(flat, PLAIN * WIDTH, select(plain, spread(1.0), spread(0.0)))


@compiled
def turn_segments(both: Floats, work: Floats) -> None:
    """From a standstill in mid-air to the next rise or fall, hanging between, in every lane that stands still."""
    flat = work.reshape(-1)
    stops = _row(flat, STOPS) > 0.5
    up, down = (_row(flat, UP), _row(flat, UP_LAST)), (_row(flat, DOWN), _row(flat, DOWN_LAST))
    rises, wait, phi, at_edge = hang_in_lanes(both, up, down, _row(flat, X))
    total = _row(flat, TOTAL) + _row(flat, TAU)
    store(flat, TOTAL * WIDTH, total + select(stops, wait, 0.0))
    store(flat, PHI * WIDTH, select(stops, phi, _row(flat, PHI)))
    store(flat, H0 * WIDTH, select(stops, _row(flat, H), _row(flat, H0)))
    store(flat, V0 * WIDTH, select(stops, select(wait > 0.0, 0.0, _row(flat, V)), _row(flat, V0)))
    store(flat, RISING * WIDTH, select(stops, select(rises, spread(1.0), spread(0.0)), _row(flat, RISING)))
    store(flat, AT_EDGE * WIDTH, select(at_edge, spread(1.0), spread(0.0)))


@compiled
def begin(
    tones: Floats, both: Floats, closes: bool, work: Floats, whole: Integers, flights: Floats, marks: Integers,
    lane: int,
) -> None:  # fmt: skip
    """Start the orbit of a lane, whose parameters are in ``work``, from rest at phase 0."""
    whole[COUNT, lane] = whole[TURN, lane] = whole[SEGMENTS, lane] = 0
    whole[SEEN:, lane] = -1
    _leave(tones, both, closes, work, whole, flights, marks, lane, fold_onto(both, work[UP, lane], 0.0), 0.0)


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
            phi, v = _land(
                tones, both, work, whole, flights, marks, lane, work[TOTAL, lane], work[X, lane], speed
            )
            _leave(tones, both, closes, work, whole, flights, marks, lane, phi, v)


@compiled
def take_row(work: Floats, lane: int, gamma: float, law: FrictionRestitution, row: int, rows: int, size: int,
             n_up: int, n_down: int) -> None:  # fmt: skip
    """Give a lane the parameters of a row."""
    work[GAMMA, lane] = gamma
    work[MU_UP, lane], work[MU_DOWN, lane], work[E0, lane], work[E1, lane] = law
    work[UP, lane], work[UP_LAST, lane] = row * TABLE * size, 2 * n_up
    work[DOWN, lane], work[DOWN_LAST, lane] = (rows + row) * TABLE * size, 2 * n_down
