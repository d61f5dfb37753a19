"""Derivatives of what is predicted one event ahead: by earlier landings and the plate's tones.

They go along the chain of flights as the predictions do: from the landing before, by way of the impact speed, to
take-off, flight and landing. Where a prediction passes flights over, it has none; nor where the plate has a mode, whose
state is carried through fades that nothing tells all of. Decision 162.
"""

from __future__ import annotations

import math

import numpy as np

from kernels.arrays import Floats
from model.integrator.flight import flight
from model.integrator.plate import between_steps, step_length
from model.integrator.predict import AS_PREDICTED, TWO_POINTS
from model.integrator.records import Chain, Events, Law, Mode, Plate, Steps, clear, clear_rows, compiled
from model.integrator.takeoff_slopes import LANDING, LANDING_BEFORE, Leaving, Work, at_takeoff, work_for
from model.integrator.variation import LAUNCH, MOST_NODES, TAKEOFF, TONES, Room, flight_variations, room_for

SAME_S = 1e-7  # a measured flight that is flown again must land so near


@compiled
def _chained(elementary: Floats, at: Leaving, out: Floats) -> None:
    """Derivatives (d,) from those of one flight by its own start (d,) and those of the start."""
    for j in range(len(out)):
        out[j] = elementary[TAKEOFF] * at.off[j] + elementary[LAUNCH] * at.launch[j]
        if j >= TONES:
            out[j] += elementary[j]


@compiled
def slopes_ahead(
    events: Events,
    steps: Steps,
    rows: Floats,
    acting: tuple[bool, bool],
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
    room, work = room_for(k), work_for(d)
    last, sound, hit = Chain(np.inf, 0.0, 0.0, 0.0, False, 0), True, np.zeros(d)
    lengths = np.empty(len(steps.period))
    for j in range(len(lengths)):
        lengths[j] = step_length(steps.period[j], steps.tones[j])
    p = rows[0].copy()
    for i in range(len(events.landing)):
        m, landing = events.step[i], events.landing[i]
        clear_rows(out[i])
        clear(info[i])
        if len(rows) > 1:
            for j in range(len(p)):
                p[j] = rows[i, j]
        if not events.wanted[i] and found[i, 11] == 0.0:
            last, sound = Chain(landing, last.impact, 0.0, 0.0, True, 0), True
            clear(hit)
            continue
        tones, length = steps.tones[m], lengths[m]
        if events.share[i] > 0.0:
            tones = between_steps(steps.tones, m, events.beside[i], events.share[i])
            length = step_length(steps.period[m], tones)
        plate = Plate(tones, Mode(0.0, 0.0, 1.0, 0.0))
        law = Law(p, length, acting[0], acting[1], turning, nodes)
        if not events.linked[i]:
            last, sound = Chain(events.opening[i], last.impact, 0.0, 0.0, False, 0), True
            clear(hit)
        elif events.wanted[i] and _is_direct(found[i]):
            _predicted(events.gap_m[i], last, plate, law, hit, found[i], room, work, out[i], info[i])
            if not sound:
                info[i, 0] = 0.0
        if found[i, 11] == 0.0:
            last, sound = Chain(landing, last.impact, 0.0, 0.0, True, 0), True
            clear(hit)
            continue
        last, sound = _measured(landing, last, plate, law, hit, found[i], room, work)


@compiled
def _is_direct(found: Floats) -> bool:
    """Whether a prediction leans on the landing before and on no flight passed over.

    A ball that has come to rest remembers nothing of such flights.
    """
    return bool(found[6] >= 0.0 and found[12] == 0.0 and (found[5] == 0.0 or found[6] == 0.0))


@compiled
def _predicted(
    gap_m: float,
    last: Chain,
    plate: Plate,
    law: Law,
    hit: Floats,
    found: Floats,
    room: Room,
    work: Work,
    out: Floats,
    info: Floats,
) -> None:
    """Derivatives of one prediction, ``out`` (3, d), and its `INFO`."""
    off, v0, kind = found[0], found[1], int(found[6])
    at_takeoff((last.t, last.impact, off, v0, kind, 0.0), plate, law, hit, work, work.leaving, info)
    by = work.elementary
    law.nodes[0, 0] = 0.0
    lasts, _, opened = flight(off, v0, plate, law, gap_m)
    usable, net, v = flight_variations(off, v0, opened, plate.tones, law, room, by)
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
    plate: Plate,
    law: Law,
    hit: Floats,
    found: Floats,
    room: Room,
    work: Work,
) -> tuple[Chain, bool]:
    """Carry the chain, and the derivatives ``hit`` of its impact speed, over a measured flight; whether they are sound.

    Its landing is from now on the landing before.
    """
    begun, v0, speed, way = found[10], found[7], found[8], found[11]
    leaving, by = work.leaving, work.elementary
    start = (last.t, 0.0, begun, 0.0, 0 if begun > last.t else 1, 1e9)
    at_takeoff(start, plate, law, hit, work, leaving, work.info)
    clear(leaving.launch)  # it is found from both ends of the flight
    law.nodes[0, 0] = 0.0
    lasts, _, opened = flight(begun, v0, plate, law, 0.0)
    usable, _, _ = flight_variations(begun, v0, opened, plate.tones, law, room, by)
    own_hit = 0.0
    if way == TWO_POINTS:
        usable = usable and abs(begun + lasts - landing) < SAME_S and by[0, LAUNCH] > 0.0
        _chained(by[0], leaving, work.hits)
        if usable:
            for j in range(len(work.hits)):
                leaving.launch[j] = -work.hits[j] / by[0, LAUNCH]
            own_hit = by[1, LAUNCH] / by[0, LAUNCH]
    _chained(by[1], leaving, hit)
    for j in range(len(hit)):
        if not math.isfinite(hit[j]):
            hit[j] = 0.0
    hit[LANDING_BEFORE], hit[LANDING] = hit[LANDING], own_hit
    return Chain(landing, speed, 0.0, 0.0, True, 0), usable and way < AS_PREDICTED  # else it is not this flight's speed
