"""Each measured flight predicted from the measured landing before it; flights one after another from a start."""

from __future__ import annotations

import numpy as np

from kernels.arrays import Floats
from model.integrator.flight import LONGEST_PERIODS, flight
from model.integrator.hooks import plate_mode
from model.integrator.plate import (
    between_steps,
    corrected,
    mode_at,
    mode_at_rest,
    mode_under_ball,
    project_mode,
    step_length,
    strike,
    with_state,
)
from model.integrator.records import (
    Acting,
    Chain,
    Event,
    Events,
    Law,
    Mode,
    Plate,
    Probe,
    Steps,
    Visibility,
    compiled,
    inlined,
)
from model.integrator.takeoff import PASSABLE_S, launch_of, next_flight, thrown_before, weak_rebounds

# columns of the table of `one_ahead`: take-off, launch velocity, landing, impact speed, opening, flights passed over
# and kind (-1 none) as predicted; of the measured flight itself launch velocity and impact speed; by how much later the
# landing may be seen
TAKEOFF, LAUNCH, LANDING, IMPACT, OPENING, HIDDEN, KIND, OWN_LAUNCH, OWN_IMPACT, AMBIGUITY = range(10)
OUT_COLUMNS = 10


@compiled
def _rested(s: float, pressed: tuple[float, float], last: Chain, bare: Plate, p: Floats) -> tuple[float, float]:
    """State of the plate mode after a contact of s seconds; what was measured to press on it acts at once."""
    push, part = pressed
    if s <= 0.0 or np.isnan(push):
        return mode_under_ball(last.t, s, with_state(bare, last.q, last.qd), p)
    x, v, _ = mode_at(part * s, with_state(bare, last.q, last.qd).mode)
    x, v, _ = mode_at((1.0 - part) * s, with_state(bare, x, v - plate_mode(p)[2] * push).mode)
    return x, v


@compiled
def begin_chain(
    event: Event, period: float, last: Chain, plate: Plate, p: Floats, mode: Floats, kick: tuple[float, float]
) -> Chain:
    """A chain that begins at the opening of an event, its ``mode`` (4,) measured, or ringing on from step to step."""
    opening = event.opening
    rested = opening - last.t
    if not np.isnan(mode[2]):
        q, qd = mode[0], mode[1]
    elif 0.0 <= rested < LONGEST_PERIODS * period:
        q, qd = _rested(rested, (event.pressed_mps, event.pressed_at), last, plate, p)
    else:
        q, qd, _ = mode_at_rest(opening, plate.tones, p)
    loose = 1.0 if np.isnan(event.pressed_mps) else 0.2  # a measured push tells most of the mode's motion
    return Chain(opening, last.impact, q + loose * kick[0], qd + loose * kick[1], False, 0)


@compiled
def _predict(event: Event, last: Chain, bare: Plate, law: Law, seen: Visibility, out: Floats) -> int:
    """Write the prediction of an event from the landing before; return the weak impacts passed."""
    # the measured flight was seen, so no flight as long as it is passed over
    shortest = min(seen.unseen_s, 0.5 * (event.landing - event.opening))
    own = Visibility(event.gap_m, shortest, seen.closure_s)
    plate = with_state(bare, last.q, last.qd)
    found = next_flight(last.t, last.impact, plate, law, own, event.opening)
    land, hit, passed = found.landing, found.impact, 0
    if found.kind >= 0 and (hit < event.weak_mps or (event.bounces and seen.closure_s == 0.0)):
        q, qd = strike(with_state(bare, found.q, found.qd).mode, land - found.takeoff, hit, law.p)
        struck = with_state(bare, q, qd)
        land, hit, passed, out[AMBIGUITY] = weak_rebounds((land, hit), event.landing, event.weak_mps, seen, struck, law)
    out[TAKEOFF], out[LAUNCH], out[LANDING], out[IMPACT] = found.takeoff, found.launch, land, hit
    out[OPENING], out[HIDDEN], out[KIND] = found.opening, found.hidden, found.kind
    return passed


@inlined
def _measured(
    event: Event, period: float, last: Chain, bare: Plate, law: Law, passed: int, out: Floats
) -> tuple[float, float, float, float, float]:
    """Start, launch velocity and impact speed of a measured flight itself, and the mode's state at the start."""
    opening, landing, bounces, p = event.opening, event.landing, event.bounces, law.p
    pressed = (event.pressed_mps if event.linked else np.nan, event.pressed_at)  # else it has acted
    direct, start, lasts, v0, hit = event.relaunched and event.linked, last.t, -1.0, 0.0, 0.0
    if not (direct and bounces):  # without a bounce the ball leaves as if from rest, at once or soon after
        q, qd = _rested(opening - last.t, pressed, last, bare, p)
        start = max(thrown_before(opening, period, with_state(bare, q, qd), law), last.t)
    q, qd = _rested(start - last.t, pressed, last, bare, p)
    if not (event.relaunched and bounces):
        lasts, hit, _ = flight(start, 0.0, with_state(bare, q, qd), law, 0.0)
    # a flight from rest that lands farther from the measured landing is another one
    if lasts < 0.0 or abs(start + lasts - landing) > 0.1 * period:
        if direct:
            start, q, qd = last.t, last.q, last.qd
        # the prediction is a flight whose landing is known: a start for the secant
        near = out[LAUNCH] if passed == 0 and out[KIND] == 1.0 and event.relaunched else -1.0
        v0, hit = launch_of(start, landing, near, out[LANDING], with_state(bare, q, qd), law)
    return start, v0, hit, q, qd


@inlined
def _impact(event: Event, v0: float, hit: float, several: bool, rings: bool, out: Floats) -> float:
    """Impact speed of a measured flight: as flown (``hit``), predicted where it is several flights, or measured."""
    if several:  # only the prediction knows its end
        hit = out[IMPACT]
    if rings and not np.isnan(event.gained_mps):
        # by the accelerometer's integral over the flight
        hit = event.gained_mps - (v0 if event.bounces and event.relaunched else 0.0)
    return max(hit, 0.0)


@compiled
def step_lengths(steps: Steps) -> Floats:
    """Integration step of each step of the run, (m,), s."""
    lengths = np.empty(len(steps.period))
    for j in range(len(lengths)):
        lengths[j] = step_length(steps.period[j], steps.tones[j])
    return lengths


@inlined
def plate_of(i: int, events: Events, steps: Steps, lengths: Floats) -> tuple[Floats, float]:
    """The plate's tones (k, 3) under an event, between two steps while the drive fades; the integration step."""
    m = events.step[i]
    tones, length = steps.tones[m], lengths[m]
    if events.share[i] > 0.0:
        tones = between_steps(steps.tones, m, events.other_step[i], events.share[i])
        length = step_length(steps.period[m], tones)
    if events.part[i] != 0.0 or events.ahead_s[i] != 0.0:
        tones = corrected(tones, events.part[i], events.ahead_s[i])
    return tones, length


@compiled
def one_ahead(
    events: Events, steps: Steps, acting: Acting, seen: Visibility, kick: tuple[float, float], probe: Probe,
    out: Floats,
) -> None:  # fmt: skip
    """Fill ``out`` (n, `OUT_COLUMNS`), and add what the plate mode does to the projections of ``probe``.

    ``kick``, or a part of it after a measured fade, is added to the plate mode's state wherever a chain begins.
    """
    rows, forced, rubbed = acting
    last = Chain(np.inf, 0.0, 0.0, 0.0, False, 0)
    turning = np.empty((steps.tones.shape[1] + 1, 6))
    lengths = step_lengths(steps)
    om, ze, ratio = plate_mode(rows[0])
    n = events.landing.shape[0]
    for i in range(n):
        p = rows[i if len(rows) > 1 else 0]
        m, landing, bounces = events.step[i], events.landing[i], events.bounces[i]
        measured = not np.isnan(events.mode[i, 2])
        if len(rows) > 1:
            om, ze, ratio = plate_mode(p)
        out[i, KIND], out[i, AMBIGUITY] = -1.0, 0.0
        # a predicted flight needs the flight before, and the prediction of that to know which landing it was: two more
        soon = (i + 1 < n and events.wanted[i + 1]) or (i + 2 < n and events.wanted[i + 2])
        needed = (ratio != 0.0 and not measured) or (bounces and soon)
        after_q, after_qd = (events.mode[i, 2], events.mode[i, 3]) if measured else (0.0, 0.0)
        if not (events.wanted[i] or needed):  # nothing needs more of it than its landing
            last = Chain(landing, last.impact, after_q, after_qd, True, 0)
            continue
        tones, length = plate_of(i, events, steps, lengths)
        bare = Plate(tones, Mode(0.0, 0.0, om, ze))
        law = Law(p, length, forced, rubbed, turning)
        event = Event(
            events.opening[i], landing, events.relaunched[i], events.linked[i], bounces, events.gap_m[i],
            events.weak_mps[i], events.gained_mps[i], events.pressed_mps[i], events.pressed_at[i],
        )  # fmt: skip
        passed, chained = 0, last.chained + 1
        if not event.linked:
            chained = 0
            last = begin_chain(event, steps.period[m], last, bare, p, events.mode[i], kick)
        elif (events.wanted[i] or bounces) and (last.known or not bounces):
            passed = _predict(event, last, bare, law, seen, out[i])
        if not (needed or (bounces and events.wanted[i])):
            if not measured:
                after_q, after_qd = last.q, last.qd
            last = Chain(landing, last.impact, after_q, after_qd, True, 0)
            continue
        start, v0, hit, q, qd = _measured(event, steps.period[m], last, bare, law, passed, out[i])
        several = passed > 0 and chained > 1 and abs(out[i, LANDING] - landing) < PASSABLE_S
        hit = _impact(event, v0, hit, several, ratio != 0.0, out[i])
        out[i, OWN_LAUNCH], out[i, OWN_IMPACT] = v0, hit
        flying = with_state(bare, q, qd)
        if ratio != 0.0 and events.linked[i]:
            project_mode(last.t, start, True, with_state(bare, last.q, last.qd), p, probe, m)
            project_mode(start, landing, False, flying, p, probe, m)
        if not measured:
            after_q, after_qd = strike(flying.mode, landing - start, hit, p)
        last = Chain(landing, hit, after_q, after_qd, True, chained)


@compiled
def simulate(
    start_s: float, impact: float, period: float, tones: Floats, bare: Law, unseen_s: float, out: Floats
) -> int:
    """Flights one after another from an impact: fills ``out`` (n, 6) and returns how many.

    Columns: take-off, launch velocity, landing, impact speed, kind, flights passed over.
    """
    p = bare.p
    om, ze, _ = plate_mode(p)
    plate = Plate(tones, Mode(0.0, 0.0, om, ze))
    law = Law(p, step_length(period, tones), bare.forced, bare.rubbed, np.empty((tones.shape[0] + 1, 6)))
    seen = Visibility(0.0, unseen_s, 0.0)
    t = start_s
    for i in range(out.shape[0]):
        found = next_flight(t, impact, plate, law, seen, -1e300)
        if found.kind < 0:
            return i
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = found.takeoff, found.launch, found.landing, found.impact
        out[i, 4], out[i, 5] = found.kind, found.hidden
        q, qd = strike(with_state(plate, found.q, found.qd).mode, found.landing - found.takeoff, found.impact, p)
        plate = with_state(plate, q, qd)
        t, impact = found.landing, found.impact
    return len(out)
