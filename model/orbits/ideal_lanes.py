"""Ideal orbits side by side: as those of `model.orbits.cycles`, an orbit a lane.

All lanes together find their landings (`model.flight.lanes.ideal_lanes`); whether a ball waits for a threshold, and
whether that closes its orbit, is decided lane by lane. Decision 154.
"""

from __future__ import annotations

from kernels.arrays import Floats
from kernels.lanes import WIDTH, select, spread, store
from model.flight.ideal import land, take_off_pull
from model.flight.lanes.ideal_lanes import land_lanes
from model.flight.numerics import compiled
from model.flight.segment import shape
from model.orbits import lane_state as at
from model.orbits.lane_state import Lanes, keep_landing, leave_of, numbers, tables_of_lane

leave = leave_of(bounces=False)


@compiled
def _land_one(tones: Floats, both: Floats, work: Floats, lane: int) -> None:
    """A flight that is not plain, by `model.flight.ideal.land`."""
    gamma, phi0, tables = work[at.GAMMA, lane], work[at.PHI, lane], tables_of_lane(both, work, lane)
    a0 = take_off_pull(tones, gamma, phi0, work[at.AT_EDGE, lane] == 1.0)
    tau, phi, speed, _ = land(tones, gamma, tables.up, tables.n_up, phi0, a0, 0.0)
    work[at.TAU, lane], work[at.X, lane], work[at.V, lane] = tau, phi, speed
    work[at.S_X, lane], work[at.SLOPE_X, lane], _ = shape(tones, phi)


@compiled
def _land_all(tones: Floats, highest: float, both: Floats, work: Floats) -> None:
    """The landings of all lanes."""
    flat = work.reshape(-1)
    phi = numbers(flat, at.PHI)
    place = numbers(flat, at.UP), numbers(flat, at.UP_LAST), numbers(flat, at.BRANCH)
    x, turns, speed, (s, slope), plain = land_lanes(
        tones, highest, both, numbers(flat, at.GAMMA), place, (phi, numbers(flat, at.S), numbers(flat, at.SLOPE))
    )
    store(flat, at.TAU * WIDTH, x - phi + turns)
    store(flat, at.X * WIDTH, x)
    store(flat, at.V * WIDTH, speed)
    store(flat, at.S_X * WIDTH, s)
    store(flat, at.SLOPE_X * WIDTH, slope)
    store(flat, at.PLAIN * WIDTH, select(plain, spread(1.0), spread(0.0)))


@compiled
def advance(tones: Floats, highest: float, lanes: Lanes, closes: bool) -> None:
    """One flight of every lane that flies, and what follows it."""
    both, work, whole, _, _ = lanes
    _land_all(tones, highest, both, work)
    for lane in range(WIDTH):
        if whole[at.STATUS, lane] != at.FLIES:
            continue
        if work[at.PLAIN, lane] == 0.0:
            _land_one(tones, both, work, lane)
        landing = work[at.TAU, lane], work[at.X, lane], work[at.V, lane]
        work[at.LAST_PHI, lane], _ = keep_landing(tones, lanes, lane, *landing, False)
        leave(tones, lanes, closes, lane)
