"""Orbits with friction and restitution side by side: as those of `model.orbits.cycles`, an orbit a lane.

All lanes that rise find the end of the rise together, then all that fall (`model.flight.lanes.friction_lanes`). A lane
known to land waits until there are `ENOUGH` of them, and their landings are located together. What is rare (hanging,
what is not plain) and what comes between two flights (rebound, short bounces, the tail of a chatter, a threshold that
repeats) is done lane by lane.
"""

from __future__ import annotations

from typing import Any

from kernels.arrays import Floats, Integers
from kernels.lanes import WIDTH, any_of, count, select, spread, store
from model.flight.branches import fold
from model.flight.friction import MOST_SEGMENTS, hang, rise
from model.flight.lanes.friction_lanes import fall_in_lanes, land_in_lanes, rise_in_lanes
from model.flight.numerics import Number, Segment, compiled, inlined
from model.flight.segment import landing_or_standstill, motion, segment_from, shape
from model.orbits import lane_state as at
from model.orbits.lane_state import Lanes, keep_landing, leave_of, numbers, places_of_branches, tables_of_lane

ENOUGH = 8  # lanes that land, for their landings to be located together
PLAIN_PULL = 1e-9  # pulls nearer to an edge's than this are decided by the table

leave = leave_of(bounces=True)


@compiled
def _move_one(tones: Floats, both: Floats, work: Floats, lane: int) -> None:
    """A segment that is not plain, by `model.flight.friction`; fills the lane as `_rise` and `_fall` do."""
    gamma, rises = work[at.GAMMA, lane], work[at.MOTION, lane] == at.RISES
    level = 1.0 + work[at.MU_UP, lane] if rises else 1.0 - work[at.MU_DOWN, lane]
    up, n_up, down, n_down = tables_of_lane(both, work, lane)
    edge, n_windows = (up, n_up) if rises else (down, n_down)
    phi0 = fold(work[at.PHI, lane], edge[0]) if n_windows > 0 else work[at.PHI, lane]
    at_edge = work[at.AT_EDGE, lane] == 1.0
    segment = segment_from(tones, gamma, phi0, work[at.V0, lane], work[at.H0, lane], level, at_edge)
    landed = False
    if rises:
        tau, phi = rise(tones, gamma, edge, n_windows, segment)
    else:
        landed, tau, phi, _, _ = landing_or_standstill(tones, gamma, edge, n_windows, segment, True)
    h, v, _ = motion(tones, gamma, segment, phi, tau)
    s, slope, q = shape(tones, phi)
    work[at.S_X, lane], work[at.SLOPE_X, lane], work[at.Q_X, lane] = s, slope, q
    if landed or h <= 0.0:  # or lifted by less than rounding
        work[at.TAU, lane], work[at.X, lane], work[at.MOTION, lane] = tau, phi, at.LANDED
        work[at.V, lane] = v if landed else 0.0
        return
    work[at.PHI, lane], work[at.H0, lane], work[at.V0, lane], work[at.MOTION, lane] = phi, h, v, at.HANGS
    work[at.S, lane], work[at.SLOPE, lane], work[at.Q, lane] = s, slope, q
    work[at.TOTAL, lane] += tau
    work[at.AT_EDGE, lane] = 0.0


@compiled
def _hang(tones: Floats, both: Floats, work: Floats, lane: int) -> None:
    """From a standstill in mid-air to the next rise or fall."""
    up, n_up, down, n_down = tables_of_lane(both, work, lane)
    rises, wait, phi, at_edge = hang(up, n_up, down, n_down, work[at.PHI, lane])
    work[at.MOTION, lane], work[at.PHI, lane] = at.RISES if rises else at.FALLS, phi
    work[at.AT_EDGE, lane] = 1.0 if at_edge else 0.0
    work[at.TOTAL, lane] += wait
    if wait > 0.0:
        work[at.V0, lane] = 0.0
        work[at.S, lane], work[at.SLOPE, lane], work[at.Q, lane] = shape(tones, phi)


@inlined
def _segment(flat: Floats, gamma: Number, level: Number) -> Segment:
    """The segment under way in every lane."""
    pull = select(numbers(flat, at.AT_EDGE) > 0.5, 0.0, gamma * numbers(flat, at.Q) - level)
    s, slope, v0, h0 = numbers(flat, at.S), numbers(flat, at.SLOPE), numbers(flat, at.V0), numbers(flat, at.H0)
    return Segment(numbers(flat, at.PHI), s, slope, pull, v0, h0, level)


@inlined
def _put(flat: Floats, name: int, mask: Any, value: Any) -> None:
    """Write ``value`` to a row where ``mask``."""
    store(flat, name * WIDTH, select(mask, value, numbers(flat, name)))


@inlined
def _turn(flat: Floats, stands: Any, end: Any, motion_after: Any) -> None:
    """Begin the next segment in the lanes that stand still at the ``end`` of one: tau, phase, h, h', (s, s', q)."""
    tau, x, h, v, (s, slope, q) = end
    _put(flat, at.PHI, stands, x)
    _put(flat, at.H0, stands, h)
    _put(flat, at.V0, stands, v)
    _put(flat, at.S, stands, s)
    _put(flat, at.SLOPE, stands, slope)
    _put(flat, at.Q, stands, q)
    _put(flat, at.TOTAL, stands, numbers(flat, at.TOTAL) + tau)
    _put(flat, at.AT_EDGE, stands, 0.0)
    _put(flat, at.MOTION, stands, motion_after)


@compiled
def _rise(tones: Floats, flat: Floats, rows: tuple[int, int]) -> bool:
    """The ends of all rises; whether some lane is not plain, or hangs."""
    gamma = numbers(flat, at.GAMMA)
    rises = numbers(flat, at.MOTION) == at.RISES
    segment = _segment(flat, gamma, 1.0 + numbers(flat, at.MU_UP))
    tau, x, h, v, plate, plain = rise_in_lanes(tones, flat, rows, gamma, segment, rises)
    stands = rises & plain
    falls = gamma * plate[2] < 1.0 - numbers(flat, at.MU_DOWN) - PLAIN_PULL
    _turn(flat, stands, (tau, x, h, v, plate), select(falls, spread(at.FALLS), at.HANGS))
    _put(flat, at.SEGMENTS, rises, numbers(flat, at.SEGMENTS) + 1.0)
    store(flat, at.PLAIN * WIDTH, select(rises & ~plain, spread(0.0), 1.0))
    left: bool = any_of(rises & ~(plain & falls))
    return left


@compiled
def _fall(tones: Floats, flat: Floats, rows: tuple[int, int]) -> bool:
    """The ends of all falls, or that they land; whether some lane is not plain, hangs, or has moved for too long."""
    gamma = numbers(flat, at.GAMMA)
    falls = numbers(flat, at.MOTION) == at.FALLS
    segment = _segment(flat, gamma, 1.0 - numbers(flat, at.MU_DOWN))
    tau, x, h, v, plate, lands, plain = fall_in_lanes(tones, flat, rows, gamma, segment, falls)
    stands = falls & plain & ~lands
    rises = gamma * plate[2] > 1.0 + numbers(flat, at.MU_UP) + PLAIN_PULL
    _turn(flat, stands, (tau, x, h, v, plate), select(rises, spread(at.RISES), at.HANGS))
    _put(flat, at.MOTION, falls & lands, at.LANDS)
    store(flat, at.TAU * WIDTH, select(falls, tau, numbers(flat, at.TAU)))
    _put(flat, at.H, falls, h)
    _put(flat, at.Q_X, falls, plate[2])
    segments = numbers(flat, at.SEGMENTS) + 1.0
    _put(flat, at.SEGMENTS, falls, segments)
    store(flat, at.PLAIN * WIDTH, select(falls & ~plain, spread(0.0), 1.0))
    left: bool = any_of(falls & ~lands & (~(plain & rises) | (segments >= MOST_SEGMENTS)))
    return left


@compiled
def _locate(tones: Floats, flat: Floats, rows: tuple[int, int]) -> bool:
    """The landings of all lanes that wait for theirs; whether some lane is not plain."""
    gamma = numbers(flat, at.GAMMA)
    lands = numbers(flat, at.MOTION) == at.LANDS
    segment = _segment(flat, gamma, 1.0 - numbers(flat, at.MU_DOWN))
    stop = numbers(flat, at.TAU), numbers(flat, at.H), numbers(flat, at.Q_X)
    tau, x, v, (s, slope, q), plain = land_in_lanes(tones, flat, rows, gamma, segment, stop, lands)
    _put(flat, at.TAU, lands, tau)
    _put(flat, at.X, lands, x)
    _put(flat, at.V, lands, v)
    _put(flat, at.S_X, lands, s)
    _put(flat, at.SLOPE_X, lands, slope)
    _put(flat, at.Q_X, lands, q)
    _put(flat, at.MOTION, lands, select(plain, spread(at.LANDED), at.FALLS))
    _put(flat, at.PLAIN, lands, select(plain, spread(1.0), 0.0))
    left: bool = any_of(lands & ~plain)
    return left


@compiled
def _one_by_one(tones: Floats, both: Floats, work: Floats, whole: Integers) -> None:
    """What is not plain, or hangs, or has moved for too long."""
    for lane in range(WIDTH):
        if work[at.PLAIN, lane] == 0.0:
            work[at.PLAIN, lane] = 1.0
            _move_one(tones, both, work, lane)
        if work[at.MOTION, lane] == at.HANGS:
            _hang(tones, both, work, lane)
        moves = work[at.MOTION, lane] == at.RISES or work[at.MOTION, lane] == at.FALLS
        if moves and work[at.SEGMENTS, lane] >= MOST_SEGMENTS:
            whole[at.STATUS, lane], work[at.MOTION, lane] = at.STUCK, at.RESTS


@compiled
def advance(tones: Floats, highest: float, lanes: Lanes, closes: bool) -> None:
    """Segments of all lanes until `ENOUGH` land, and what follows each landing."""
    both, work, whole, _, _ = lanes
    flat = work.reshape(-1)
    windows, of_rises, of_falls, of_edges = places_of_branches(work)
    while True:
        if _rise(tones, flat, (of_rises, windows)):
            _one_by_one(tones, both, work, whole)
        if _fall(tones, flat, (of_falls, windows)):
            _one_by_one(tones, both, work, whole)
        state = numbers(flat, at.MOTION)
        if count(state >= at.LANDS) >= ENOUGH or not any_of((state == at.RISES) | (state == at.FALLS)):
            break
    if _locate(tones, flat, (of_edges, windows)):
        _one_by_one(tones, both, work, whole)
    for lane in range(WIDTH):
        if work[at.MOTION, lane] == at.LANDED:
            tau, speed = work[at.TOTAL, lane] + work[at.TAU, lane], max(-work[at.V, lane], 0.0)
            phi, v = keep_landing(tones, lanes, lane, tau, work[at.X, lane], speed, True)
            work[at.LAST_PHI, lane], work[at.LAST_V, lane] = phi, v
            leave(tones, lanes, closes, lane)
