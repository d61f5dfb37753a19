"""Derivatives of what is predicted one event ahead: by earlier landings, the plate's tones and wanted parameters.

They go along the chain of flights as the predictions do: from the landing before, by way of the impact speed and the
state of a plate mode, to take-off, flight and landing. Where a prediction passes flights over, it has none; what the
accelerometer tells of a plate mode in a fade is not followed.
"""

from __future__ import annotations

import math

import numpy as np

from model.integrator.flight import LONGEST_PERIODS, flight
from model.integrator.hooks import plate_mode, rebound
from model.integrator.plate import between_steps, mode_at, mode_under_ball, step_length, strike, with_state
from model.integrator.predict import AS_PREDICTED, TWO_POINTS, begin_chain
from model.integrator.records import Chain, Events, Floats, Law, Mode, Plate, Steps, clear, clear_rows, compiled
from model.integrator.takeoff_slopes import (
    KICK,
    KICK_RATE,
    LANDING,
    LANDING_BEFORE,
    Last,
    Leaving,
    Work,
    at_takeoff,
    rest_response,
    steeper,
    work_for,
)
from model.integrator.variation import (
    LAUNCH,
    MOST_NODES,
    RATE,
    SHIFT,
    TAKEOFF,
    TONES,
    Columns,
    Room,
    flight_variations,
    room_for,
)

SAME_S = 1e-7  # a measured flight that is flown again must land so near


@compiled
def _chained(elementary: Floats, at: Leaving, out: Floats) -> None:
    """Derivatives (d,) from those of one flight by its own start (e,) and those of the start."""
    for j in range(len(out)):
        out[j] = elementary[TAKEOFF] * at.off[j] + elementary[LAUNCH] * at.launch[j]
        out[j] += elementary[SHIFT] * at.q[j] + elementary[RATE] * at.qd[j]
        if j >= TONES:
            out[j] += elementary[j]


@compiled
def slopes_ahead(
    events: Events,
    steps: Steps,
    rows: Floats,
    acting: tuple[bool, bool],
    kick: tuple[float, float],
    columns: Columns,
    found: Floats,
    out: Floats,
    info: Floats,
) -> None:
    """Derivatives of openings, landings and impact speeds, ``out`` (n, 3, d).

    ``found`` (n, ...) is the table of `predict.one_ahead`; ``info`` (n, `INFO`) tells where derivatives can be used,
    and what their second order is about.
    """
    k, d = steps.tones.shape[1], out.shape[2]
    turning, nodes = np.empty((k + 1, 6)), np.empty((MOST_NODES, 12))
    room, work = room_for(k, len(columns.place)), work_for(d)
    last, sound = Chain(np.inf, 0.0, 0.0, 0.0, False, 0), True
    carried = Last(np.zeros(d), np.zeros(d), np.zeros(d))
    lengths = np.empty(len(steps.period))
    for j in range(len(lengths)):
        lengths[j] = step_length(steps.period[j], steps.tones[j])
    p = rows[0].copy()
    om, ze, ratio = plate_mode(p)
    for i in range(len(events.landing)):
        m, landing = events.step[i], events.landing[i]
        clear_rows(out[i])
        clear(info[i])
        if len(rows) > 1:
            for k in range(len(p)):
                p[k] = rows[i, k]
            om, ze, ratio = plate_mode(p)
        if not events.wanted[i] and found[i, 11] == 0.0:
            last, sound = Chain(landing, last.impact, last.q, last.qd, True, 0), True
            clear(carried.hit)
            continue
        tones, length = steps.tones[m], lengths[m]
        if events.share[i] > 0.0:
            tones = between_steps(steps.tones, m, events.beside[i], events.share[i])
            length = step_length(steps.period[m], tones)
        bare = Plate(tones, Mode(0.0, 0.0, om, ze))
        law = Law(p, length, acting[0], acting[1], turning, nodes)
        if not events.linked[i]:
            before, sound = last.t, True
            last = begin_chain(i, events, steps.period[m], last, bare, p)
            last = Chain(last.t, last.impact, last.q + kick[0], last.qd + kick[1], False, 0)
            clear(carried.hit)
            if ratio != 0.0:
                _begun(before, last, tones, om, ze, ratio, p, carried)
        elif events.wanted[i] and _is_direct(found[i], ratio):
            _predicted(events.gap_m[i], last, bare, law, carried, columns, found[i], room, work, out[i], info[i])
            if not sound:
                info[i, 0] = 0.0
        if found[i, 11] == 0.0:
            last, sound = Chain(landing, last.impact, last.q, last.qd, True, 0), True
            clear(carried.hit)
            clear(carried.q)
            clear(carried.qd)
            continue
        last, sound = _measured(landing, last, bare, law, carried, columns, found[i], room, work)


@compiled
def _is_direct(found: Floats, ratio: float) -> bool:
    """Whether a prediction leans on the landing before and on no flight passed over.

    A ball that has come to rest on a plate without a mode remembers nothing of such flights.
    """
    return found[6] >= 0.0 and found[12] == 0.0 and (found[5] == 0.0 or (found[6] == 0.0 and ratio == 0.0))


@compiled
def _predicted(
    gap_m: float,
    last: Chain,
    bare: Plate,
    law: Law,
    carried: Last,
    columns: Columns,
    found: Floats,
    room: Room,
    work: Work,
    out: Floats,
    info: Floats,
) -> None:
    """Derivatives of one prediction, ``out`` (3, d), and its `INFO`."""
    off, v0, kind, resting = found[0], found[1], int(found[6]), with_state(bare, last.q, last.qd)
    start = (last.t, last.impact, off, v0, kind, 0.0)
    at_takeoff(start, resting, law, carried, columns, work, work.leaving, info)
    q, qd = mode_under_ball(last.t, off - last.t, resting, law.p)
    flying, by = with_state(bare, q, qd), work.elementary
    law.nodes[0, 0] = 0.0
    lasts, _, opened = flight(off, v0, flying, law, gap_m)
    usable, net, v = flight_variations(off, v0, opened, flying, law, columns, room, by)
    same = abs(off + lasts - found[2]) + abs(off + max(opened, 0.0) - found[4]) < SAME_S
    info[0] = 1.0 if usable and same else 0.0
    info[3], info[4], info[5] = lasts, net, v
    _chained(by[2], work.leaving, out[0])
    _chained(by[0], work.leaving, out[1])
    _chained(by[1], work.leaving, out[2])


@compiled
def _measured(
    landing: float,
    last: Chain,
    bare: Plate,
    law: Law,
    carried: Last,
    columns: Columns,
    found: Floats,
    room: Room,
    work: Work,
) -> tuple[Chain, bool]:
    """Carry the chain, and its derivatives ``carried``, over a measured flight; whether they can be used."""
    begun, v0, hit, way, p = found[10], found[7], found[8], found[11], law.p
    resting, leaving, by = with_state(bare, last.q, last.qd), work.leaving, work.elementary
    start = (last.t, 0.0, begun, 0.0, 0 if begun > last.t else 1, 1e9)
    at_takeoff(start, resting, law, carried, columns, work, leaving, work.info)
    clear(leaving.launch)  # it is found from both ends of the flight
    q, qd = mode_under_ball(last.t, begun - last.t, resting, p)
    flying = with_state(bare, q, qd)
    law.nodes[0, 0] = 0.0
    lasts, _, opened = flight(begun, v0, flying, law, 0.0)
    usable, _, _ = flight_variations(begun, v0, opened, flying, law, columns, room, by)
    own_hit = 0.0
    if way == TWO_POINTS:
        usable = usable and abs(begun + lasts - landing) < SAME_S and by[0, LAUNCH] > 0.0
        _chained(by[0], leaving, work.hits)
        if usable:
            for j in range(len(work.hits)):
                leaving.launch[j] = -work.hits[j] / by[0, LAUNCH]
            own_hit = by[1, LAUNCH] / by[0, LAUNCH]
    _chained(by[1], leaving, carried.hit)
    _after(landing - begun, hit, own_hit, flying, leaving, carried, p)
    q, qd = strike(flying.mode, landing - begun, hit, p)
    return Chain(landing, hit, q, qd, True, 0), usable and way < AS_PREDICTED  # else its speed is not this flight's


@compiled
def _begun(before: float, last: Chain, tones: Floats, om: float, ze: float, ratio: float, p: Floats, at: Last) -> None:
    """Derivatives of the mode's state where a chain begins; it may ring on from the landing ``before``."""
    d = len(at.q)
    then, now = np.zeros((3, d)), np.zeros((3, d))
    rest_response(last.t, tones, p, now)
    rested = last.t - before
    if 0.0 <= rested < LONGEST_PERIODS * 2.0 * math.pi / tones[0, 0]:
        rest_response(before, tones, p, then)
        root = math.sqrt(1.0 + ratio)
        one = mode_at(rested, Mode(1.0, 0.0, om / root, ze / root))
        two = mode_at(rested, Mode(0.0, 1.0, om / root, ze / root))
        for j in range(d):
            q, qd = at.q[j] - then[0, j], at.qd[j] - then[1, j]
            at.q[j], at.qd[j] = q * one[0] + qd * two[0], q * one[1] + qd * two[1]
    else:
        clear(at.q)
        clear(at.qd)
    for j in (LANDING, LANDING_BEFORE):
        at.q[j], at.qd[j] = 0.0, 0.0
    for j in range(d):
        at.q[j] += now[0, j]
        at.qd[j] += now[1, j]
    at.q[KICK] += 1.0
    at.qd[KICK_RATE] += 1.0


@compiled
def _after(lasts: float, hit: float, own_hit: float, flying: Plate, at: Leaving, last: Last, p: Floats) -> None:
    """Derivatives just after an impact, ``last``, whose own landing is from now on the landing before.

    ``own_hit`` is the derivative of its speed by its own landing.
    """
    d = len(last.hit)
    for j in range(d):
        if not math.isfinite(last.hit[j]):
            last.hit[j] = 0.0
    last.hit[LANDING_BEFORE], last.hit[LANDING] = last.hit[LANDING], own_hit
    om, ze, ratio = plate_mode(p)
    if ratio == 0.0:
        clear(last.q)
        clear(last.qd)
        return
    one, two = mode_at(lasts, Mode(1.0, 0.0, om, ze)), mode_at(lasts, Mode(0.0, 1.0, om, ze))
    _, rate, acceleration = mode_at(lasts, flying.mode)
    for j in range(d):
        last.q[j], last.qd[j] = at.q[j] * one[0] + at.qd[j] * two[0], at.q[j] * one[1] + at.qd[j] * two[1]
    last.q[LANDING_BEFORE], last.qd[LANDING_BEFORE] = last.q[LANDING], last.qd[LANDING]
    last.q[LANDING], last.qd[LANDING] = rate, acceleration
    share = ratio / (1.0 + ratio) * (1.0 + rebound(hit, p) + hit * steeper(hit, p))
    for j in range(d):
        last.qd[j] -= share * last.hit[j]
