"""Derivatives of what is predicted one event ahead: by earlier landings and the plate's tones.

Exact, by the variational equations, without another flight; partial derivatives of an effect's hooks are differences of
the hook itself at the states of the flight, so that a hook is written without its derivatives. Whole predictions,
differenced, are the test of it.

They go along the chain of flights as the predictions do: from the landing before, by way of the impact speed, to
take-off, flight and landing. Where a prediction passes flights over, it has none; nor where the plate has a mode, whose
state is carried through fades that nothing tells all of. Decision 162.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kernels.arrays import Floats
from model.integrator import predict
from model.integrator.flight import NODE_COLUMNS, flight, pull
from model.integrator.hooks import dry_friction, force, rebound, takeoff_threshold
from model.integrator.one_step import Predicted, Problem
from model.integrator.plate import tones_at
from model.integrator.problem import Detection, Measured, PlateSteps, active, for_kernel
from model.integrator.records import Acting, Chain, Events, Law, Mode, Plate, Steps, clear, clear_rows, compiled
from model.integrator.takeoff import MOST_RESTITUTION
from model.integrator.variation import (
    LAUNCH,
    MOST_NODES,
    SPEED_MPS,
    TAKEOFF,
    TONES,
    Room,
    flight_variations,
    room_for,
)

LANDING, LANDING_BEFORE = 0, 1
"""Places of a derivative: by the landing before and by the one before that; both quadratures of every tone follow."""
INFO = 7
"""Of each event: usable or not; slope and half the relative curvature of what throws the ball, at take-off; how long
the flight lasts; relative acceleration and velocity at its end; by how much time its kind might change."""
FASTER_MPS = 1e-4  # difference of an impact speed
NEAR_S = 1e-5  # differences in time of what throws the ball
SAME_S = 1e-7  # a measured flight that is flown again must land so near


class Leaving(NamedTuple):
    """Derivatives at take-off, (d,) each: its time and speed."""

    off: Floats
    launch: Floats


class Work(NamedTuple):
    """Room for the d derivatives of one event.

    A flight's variations; derivatives of the last impact speed in the chain (d,); plate's acceleration at a take-off,
    and its velocity (d,); landings (d,); the take-off; derivatives of a flight by its own start (3, d); its `INFO`.
    """

    room: Room
    hit: Floats
    velocity: Floats
    acceleration: Floats
    hits: Floats
    leaving: Leaving
    elementary: Floats
    info: Floats


@compiled
def work_for(tones: int, d: int) -> Work:
    """Room for ``d`` derivatives, as many as a flight over ``tones`` tones has by its own start."""
    hit, leaving = np.zeros(d), Leaving(np.zeros(d), np.zeros(d))
    wide = np.zeros((3, d))
    return Work(room_for(tones), hit, np.zeros(d), np.zeros(d), np.zeros(d), leaving, wide, np.zeros(INFO))


@compiled
def _throws(t: float, dwell: float, plate: Plate, law: Law) -> float:
    """What throws a ball at rest at time t: positive where it leaves."""
    p, (tones, mode) = law.p, plate
    held = dry_friction(0.0, 0.0, 1.0, p) + takeoff_threshold(dwell, p)
    return float(pull(t, 0.0, 0.0, tones, mode, p, law.forced) - held)


@compiled
def at_takeoff(
    at: tuple[float, float, float, float, int, float], plate: Plate, law: Law, work: Work, info: Floats
) -> None:
    """Derivatives ``work.leaving`` at a take-off from the landing before.

    ``at`` is the time of that landing, its impact speed, time and speed of the take-off, its kind, and the ball's dwell
    less the time since the landing.
    """
    out, hit = work.leaving, work.hit
    t, impact, off, launched, kind, more = at
    since = off - t
    clear(out.off)
    clear(out.launch)
    _plate_at(off, plate.tones, work)
    over = _throws(off, since + more, plate, law)
    ahead = _throws(off + NEAR_S, since + more + NEAR_S, plate, law)
    behind = _throws(off - NEAR_S, since + more - NEAR_S, plate, law)
    rate, bend = 0.5 * (ahead - behind) / NEAR_S, (ahead + behind - 2.0 * over) / (NEAR_S * NEAR_S)
    info[1], info[2] = 0.0, 0.0
    # a pull above the threshold by more than this at the landing throws the ball at once: no root to move
    if kind == 0 and over < 1e-3 and rate > 0.0:
        info[1], info[2], info[6] = rate, 0.5 * bend / rate, since
        _when_thrown(off, since + more, rate, plate, law, work, out)
    else:
        out.off[LANDING] = 1.0
        info[6] = abs(over / rate) if rate != 0.0 and launched == 0.0 else 1.0
    e = rebound(impact, law.p)
    if kind == 1 and 0.0 < e < MOST_RESTITUTION:
        steeper = 0.5 * (rebound(impact + FASTER_MPS, law.p) - rebound(impact - FASTER_MPS, law.p)) / FASTER_MPS
        for j in range(len(out.launch)):
            out.launch[j] = (e + impact * steeper) * hit[j]


@compiled
def _plate_at(off: float, tones: Floats, work: Work) -> None:
    """Derivatives of the plate's velocity and acceleration at a take-off by its tones."""
    clear(work.velocity)
    clear(work.acceleration)
    for k in range(tones.shape[0]):
        w = tones[k, 0]
        if tones[k, 1] == 0.0 and tones[k, 2] == 0.0:
            continue
        j, c, s = TONES + 2 * k, math.cos(w * off), math.sin(w * off)
        work.acceleration[j], work.acceleration[j + 1] = c, -s
        work.velocity[j], work.velocity[j + 1] = s / w, c / w


@compiled
def _when_thrown(off: float, dwell: float, rate: float, plate: Plate, law: Law, work: Work, out: Leaving) -> None:
    """Derivatives of the time at which a ball at rest is thrown; ``rate`` is the slope of what throws it."""
    p, d = law.p, len(out.off)
    moves, u = 0.0, tones_at(off, plate.tones)[1]
    if law.forced:
        moves = 0.5 * (force(0.0, 0.0, 0.0, u + SPEED_MPS, p) - force(0.0, 0.0, 0.0, u - SPEED_MPS, p)) / SPEED_MPS
    for j in range(d):
        # implicit function: over(t, tones) = 0 at the take-off, so dt = -d over / rate
        out.off[j] = -(moves * work.velocity[j] - work.acceleration[j]) / rate
    grows = 0.5 * (takeoff_threshold(dwell + NEAR_S, p) - takeoff_threshold(dwell - NEAR_S, p)) / NEAR_S
    out.off[LANDING] -= grows / rate


@compiled
def _chained(elementary: Floats, at: Leaving, out: Floats) -> None:
    """Derivatives (d,) from those of one flight by its own start (d,) and those of the start."""
    for j in range(len(out)):
        out[j] = elementary[TAKEOFF] * at.off[j] + elementary[LAUNCH] * at.launch[j]
        if j >= TONES:
            out[j] += elementary[j]


@compiled
def slopes_ahead(events: Events, steps: Steps, acting: Acting, found: Floats, out: Floats, info: Floats) -> None:
    """Derivatives of openings, landings and impact speeds, ``out`` (n, 3, d).

    ``found`` (n, ...) is the table of `predict.one_ahead`; ``info`` (n, `INFO`) tells where derivatives can be used,
    and what their second order is about.
    """
    k, d = steps.tones.shape[1], out.shape[2]
    turning, nodes = np.empty((k + 1, 6)), np.empty((MOST_NODES, NODE_COLUMNS))
    work = work_for(k, d)
    last, sound, hit = Chain(np.inf, 0.0, 0.0, 0.0, False, 0), True, work.hit
    lengths, (rows, forced, rubbed) = predict.step_lengths(steps), acting
    p = rows[0].copy()
    for i in range(len(events.landing)):
        landing = events.landing[i]
        clear_rows(out[i])
        clear(info[i])
        if len(rows) > 1:
            for j in range(len(p)):
                p[j] = rows[i, j]
        if not events.wanted[i] and found[i, predict.WAY] == 0.0:
            last, sound = Chain(landing, last.impact, 0.0, 0.0, True, 0), True
            clear(hit)
            continue
        tones, length = predict.plate_of(i, events, steps, lengths)
        plate = Plate(tones, Mode(0.0, 0.0, 1.0, 0.0))
        law = Law(p, length, forced, rubbed, turning, nodes)
        # a prediction that needs the landing before and no flight passed over; a ball at rest remembers none
        direct = found[i, predict.KIND] >= 0.0 and found[i, predict.PASSED] == 0.0
        direct = direct and (found[i, predict.HIDDEN] == 0.0 or found[i, predict.KIND] == 0.0)
        if not events.linked[i]:
            last, sound = Chain(events.opening[i], last.impact, 0.0, 0.0, False, 0), True
            clear(hit)
        elif events.wanted[i] and direct:
            _predicted(events.gap_m[i], last, plate, law, found[i], work, out[i], info[i])
            if not sound:
                info[i, 0] = 0.0
        if found[i, predict.WAY] == 0.0:
            last, sound = Chain(landing, last.impact, 0.0, 0.0, True, 0), True
            clear(hit)
            continue
        last, sound = _measured(landing, last, plate, law, found[i], work)


@compiled
def _predicted(
    gap_m: float, last: Chain, plate: Plate, law: Law, found: Floats, work: Work, out: Floats, info: Floats
) -> None:
    """Derivatives of one prediction, ``out`` (3, d), and its `INFO`."""
    off, v0, kind = found[predict.TAKEOFF], found[predict.LAUNCH], int(found[predict.KIND])
    at_takeoff((last.t, last.impact, off, v0, kind, 0.0), plate, law, work, info)
    by = work.elementary
    law.nodes[0, 0] = 0.0
    lasts, _, opened = flight(off, v0, plate, law, gap_m)
    usable, net, v = flight_variations(off, v0, opened, plate.tones, law, work.room, by)
    opens = off + max(opened, 0.0)
    same = abs(off + lasts - found[predict.LANDING]) + abs(opens - found[predict.OPENING]) < SAME_S
    info[0] = 1.0 if usable and same else 0.0
    info[3], info[4], info[5] = lasts, net, v
    _chained(by[2], work.leaving, out[0])
    _chained(by[0], work.leaving, out[1])
    _chained(by[1], work.leaving, out[2])


@compiled
def _measured(landing: float, last: Chain, plate: Plate, law: Law, found: Floats, work: Work) -> tuple[Chain, bool]:
    """Carry the chain, and the derivatives of its impact speed, over a measured flight; whether they are sound.

    Its landing is from now on the landing before.
    """
    begun, v0 = found[predict.OWN_START], found[predict.OWN_LAUNCH]
    speed, way = found[predict.OWN_IMPACT], found[predict.WAY]
    leaving, by, hit = work.leaving, work.elementary, work.hit
    start = (last.t, 0.0, begun, 0.0, 0 if begun > last.t else 1, 1e9)
    at_takeoff(start, plate, law, work, work.info)
    clear(leaving.launch)  # it is found from both ends of the flight
    law.nodes[0, 0] = 0.0
    lasts, _, opened = flight(begun, v0, plate, law, 0.0)
    usable, _, _ = flight_variations(begun, v0, opened, plate.tones, law, work.room, by)
    own_hit = 0.0
    if way == predict.TWO_POINTS:
        usable = usable and abs(begun + lasts - landing) < SAME_S and by[0, LAUNCH] > 0.0
        _chained(by[0], leaving, work.hits)
        if usable:
            for j in range(len(work.hits)):
                # the landing is measured: the launch speed changes so that it stays where it is
                leaving.launch[j] = -work.hits[j] / by[0, LAUNCH]
            own_hit = by[1, LAUNCH] / by[0, LAUNCH]
    _chained(by[1], leaving, hit)
    for j in range(len(hit)):
        if not math.isfinite(hit[j]):
            hit[j] = 0.0
    # one flight farther: this landing is the landing before of the next
    hit[LANDING_BEFORE], hit[LANDING] = hit[LANDING], own_hit
    sound = usable and way < predict.AS_PREDICTED  # else the speed is not this flight's
    return Chain(landing, speed, 0.0, 0.0, True, 0), sound


@dataclass(frozen=True)
class Slopes:
    """Derivatives of a prediction, arrays of n events; zeros where they cannot be used.

    Parameters
    ----------
    landing, landing_before
        Of opening, landing and impact speed by the landing before and the one before that, (n, 3) each.
    tones
        By the real and imaginary part of each tone of the event's step, (n, 3, k, 2).
    info
        What the second order is about, (n, `INFO`).
    """

    landing: Floats
    landing_before: Floats
    tones: Floats
    info: Floats


def slopes_of(measured: Measured, plate: PlateSteps, rows: Floats, detection: Detection, found: Predicted) -> Slopes:
    """Derivatives of a prediction without another flight: of all it depends on.

    Parameters
    ----------
    measured, plate, rows, detection
        Those of the prediction.
    found
        The prediction, see `one_ahead`.

    Raises
    ------
    ValueError
        Where the plate has a mode, or the prediction is not of `one_ahead`.
    """
    rows = for_kernel(rows.reshape(-1, rows.shape[-1]))
    problem, tones = Problem(measured, plate, rows, detection, (0.0, 0.0)), plate.acceleration_mps2
    if active(rows, "plate_mode"):
        raise ValueError("a plate with a mode has no derivatives; wanted one without")
    if found.table is None:
        raise ValueError("the prediction was not made by one_ahead; wanted one with the kernel's table")
    n, d = len(found.table), TONES + 2 * tones.shape[1]
    out, info = np.zeros((n, 3, d)), np.zeros((n, INFO))
    events = problem.events(measured.wanted)
    slopes_ahead(events, problem.steps(tones), problem.acting, found.table, out, info)
    out[info[:, 0] == 0.0] = 0.0
    by_tone = out[..., TONES:].reshape(n, 3, tones.shape[1], 2)
    return Slopes(out[..., LANDING], out[..., LANDING_BEFORE], by_tone, info)
