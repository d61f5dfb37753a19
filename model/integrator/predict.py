"""Each measured flight predicted from the measured landing before it; flights one after another from a start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Floats
from model.integrator.flight import LONGEST_PERIODS, flight
from model.integrator.plate import (
    between_steps,
    correct,
    in_state,
    mode_at,
    mode_at_rest,
    mode_under_ball,
    project_mode,
    step_length,
    strike,
)
from model.integrator.problem import (
    Acting,
    Chain,
    Event,
    Law,
    Mode,
    Plate,
    Prediction,
    Probe,
    SecondMode,
    Steps,
    Visibility,
    compiled,
    inlined,
    plate_mode,
    rebound,
)
from model.integrator.takeoff import PASSABLE_S, launch_of, next_flight, thrown_before, weak_rebounds


@compiled
def _rested(s: float, pressed: tuple[float, float], last: Chain, bare: Plate, p: Floats) -> tuple[float, float]:
    """State of the plate mode after a contact of s seconds; what was measured to press on it acts at once."""
    push, part = pressed
    if s <= 0.0 or np.isnan(push):
        return mode_under_ball(last.t, s, Plate(bare.tones, in_state(bare.mode, last.q, last.qd)), p)
    x, v, _ = mode_at(part * s, in_state(bare.mode, last.q, last.qd))
    x, v, _ = mode_at((1.0 - part) * s, in_state(bare.mode, x, v - plate_mode(p)[2] * push))
    return x, v


@compiled
def begin_chain(event: Event, period: float, last: Chain, plate: Plate, p: Floats, kick: tuple[float, float]) -> Chain:
    """A chain that begins at the opening of an event, its mode measured, or ringing on from step to step."""
    opening = event.opening
    rested = opening - last.t
    if not np.isnan(event.after_q):
        q, qd = event.q, event.qd
    elif 0.0 <= rested < LONGEST_PERIODS * period:
        q, qd = _rested(rested, (event.pressed_mps, event.pressed_at), last, plate, p)
    else:
        q, qd, _ = mode_at_rest(opening, plate, p)
    loose = 1.0 if np.isnan(event.pressed_mps) else 0.2  # a measured push tells most of the mode's motion
    return Chain(opening, last.impact, q + loose * kick[0], qd + loose * kick[1], False, 0)


@compiled
def _turned_back(event: Event, period: float, last: Chain, bare: Plate, p: Floats) -> Chain:
    """The landing before with that state of the mode which leads to the one measured at the opening.

    Only where a second mode rings, too: the contact pressed on both, and its end shows what that did.
    """
    rested = event.opening - last.t
    if event.second_radps == 0.0 or event.relaunched or not 0.0 < rested < LONGEST_PERIODS * period:
        return last
    q, qd = mode_under_ball(event.opening, -rested, Plate(bare.tones, in_state(bare.mode, event.q, event.qd)), p)
    return Chain(last.t, last.impact, q, qd, last.known, last.chained)


@compiled
def _predict(
    event: Event, last: Chain, bare: Plate, laws: tuple[Law, Law], bounces: bool, seen: Visibility, out: Prediction
) -> tuple[int, float]:
    """Write the prediction of an event from the landing before; return the weak impacts passed, and the first flight's
    ``reach``.

    ``laws`` of the flight, and of the next one, from the impact that ends the flight on; whether it ``bounces`` there.
    """
    law, then = laws
    # the measured flight was seen, so no flight as long as it is passed over
    shortest = min(seen.unseen_s, 0.5 * (event.landing - event.opening))
    own = Visibility(event.gap_m, shortest, seen.closure_s)
    plate = Plate(bare.tones, in_state(bare.mode, last.q, last.qd))
    found = next_flight(last.t, last.impact, plate, law, own, event.opening)
    land, hit, passed = found.landing, found.impact, 0
    if found.kind >= 0 and (hit < event.weak_mps or (bounces and seen.closure_s == 0.0)):
        q, qd = strike(in_state(bare.mode, found.q, found.qd), land - found.takeoff, hit, law.p)
        struck = Plate(bare.tones, in_state(bare.mode, q, qd))
        land, hit, passed, out.ambiguity_s = weak_rebounds(
            (land, hit), event.landing, event.weak_mps, seen, struck, then
        )
    out.takeoff_s, out.launch, out.landing_s, out.impact = found.takeoff, found.launch, land, hit
    out.opening_s, out.hidden, out.kind = found.opening, found.hidden, found.kind
    return passed, found.reach


@inlined
def _measured(
    event: Event, period: float, last: Chain, bare: Plate, law: Law, predicted: tuple[int, float], out: Prediction
) -> tuple[float, float, float, float, float]:
    """Start, launch velocity and impact speed of a measured flight itself, and the mode's state at the start."""
    passed, reach = predicted
    opening, landing, bounces, p = event.opening, event.landing, event.bounces, law.p
    pressed = (event.pressed_mps if event.linked else np.nan, event.pressed_at)  # else it has acted
    direct, start, lasts, v0, hit = event.relaunched and event.linked, last.t, -1.0, 0.0, 0.0
    if not (direct and bounces):  # without a bounce the ball leaves as if from rest, at once or soon after
        q, qd = _rested(opening - last.t, pressed, last, bare, p)
        start = max(thrown_before(opening, period, Plate(bare.tones, in_state(bare.mode, q, qd)), law), last.t)
    if direct or np.isnan(event.q):
        q, qd = _rested(start - last.t, pressed, last, bare, p)
    else:  # the state after the landing before is that of a ball which leaves it
        q, qd = event.q, event.qd
    if not (event.relaunched and bounces):
        lasts, hit, _, _ = flight(
            start, 0.0, Plate(bare.tones, in_state(bare.mode, q, qd)), law, 0.0, landing + 0.1 * period - start
        )
    # a flight from rest that lands farther from the measured landing is another one
    if lasts < 0.0 or abs(start + lasts - landing) > 0.1 * period:
        if direct:
            start, q, qd = last.t, last.q, last.qd
        # the prediction is a flight whose landing is known: a start for the secant
        near = out.launch if passed == 0 and out.kind == 1.0 and out.takeoff_s == start else -1.0
        later = reach / out.impact if near >= 0.0 and out.impact > 0.0 else 0.0
        v0, hit = launch_of(
            start, landing, (near, out.landing_s, later), Plate(bare.tones, in_state(bare.mode, q, qd)), law
        )
    return start, v0, hit, q, qd


@inlined
def _impact(event: Event, v0: float, hit: float, several: bool, rings: bool, out: Prediction) -> float:
    """Impact speed of a measured flight: as flown (``hit``), predicted where it is several flights, or measured."""
    if several:  # only the prediction knows its end
        hit = out.impact
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
def _plate_under(event: Event, steps: Steps, lengths: Floats, tones: Floats) -> float:
    """Fill ``tones`` (k, 3) with the plate's under an event, between two steps while the drive fades; return the
    integration step."""
    m, length = event.step, float(lengths[event.step])
    between_steps(steps.tones, m, event.other_step, max(event.share, 0.0), tones)
    if event.share > 0.0:
        length = step_length(steps.period[m], tones)
    if event.part != 0.0 or event.ahead_s != 0.0:
        correct(tones, event.part, event.ahead_s)
    return length


@compiled
def _next(
    i: int, last: Chain, events: NDArray[np.void], every: tuple[Steps, Floats], acting: Acting, seen: Visibility,
    kick: tuple[float, float], probe: Probe, room: tuple[Floats, Floats, Floats], out: NDArray[np.void],
) -> Chain:  # fmt: skip
    """Predict event i from the ``last`` landing; the landing that ends it."""
    (rows, forced, rubbed), (steps, lengths), (tones, turning, under), n = acting, every, room, len(events)
    p, event, predicted = rows[i if len(rows) > 1 else 0], events[i], out[i]
    m, landing, bounces = event.step, event.landing, event.bounces
    measured = not np.isnan(event.after_q)
    om, ze, ratio = plate_mode(p)
    predicted.kind, predicted.ambiguity_s = -1.0, 0.0
    # what depends on the flight is, from the impact that ends it on, what it is of the next one
    goes_on = len(rows) > 1 and i + 1 < n and events[i + 1].linked
    j, rebounds = (i + 1, events[i + 1].bounces) if goes_on else (i if len(rows) > 1 else 0, bounces)
    # a predicted flight needs the flight before, and the prediction of that to know which landing it was: two more
    soon = (i + 1 < n and events[i + 1].wanted) or (i + 2 < n and events[i + 2].wanted)
    needed = (ratio != 0.0 and not measured) or ((bounces or rebounds) and soon)
    after_q, after_qd = (event.after_q, event.after_qd) if measured else (0.0, 0.0)
    if not (event.wanted or needed):  # nothing needs more of it than its landing
        return Chain(landing, last.impact, after_q, after_qd, True, 0)
    law = Law(p, _plate_under(event, steps, lengths, tones), forced, rubbed, turning, under)
    second = event.opening, event.second_q, event.second_qd, event.second_radps, event.second_damping
    bare = Plate(tones, Mode(0.0, 0.0, om, ze, SecondMode(*second)))
    passed, reach, chained = 0, 0.0, last.chained + 1
    if not event.linked:
        chained = 0
        last = begin_chain(event, steps.period[m], last, bare, p, kick)
    elif (event.wanted or bounces) and (last.known or not bounces):
        last = _turned_back(event, steps.period[m], last, bare, p)
        then = Law(rows[j], law.step_s, forced, rubbed, turning, under)
        passed, reach = _predict(event, last, bare, (law, then), rebounds, seen, predicted)
    if not (needed or (bounces and event.wanted)):
        if not measured:
            after_q, after_qd = last.q, last.qd
        return Chain(landing, last.impact, after_q, after_qd, True, 0)
    start, v0, hit, q, qd = _measured(event, steps.period[m], last, bare, law, (passed, reach), predicted)
    near = PASSABLE_S
    if bounces and predicted.hidden > 0.0 and predicted.kind == 1.0:  # an unseen bounce began it
        near, passed = min(near, 0.1 * (landing - event.opening)), passed + 1
    several = passed > 0 and chained > 1 and abs(predicted.landing_s - landing) < near
    hit = _impact(event, v0, hit, several, ratio != 0.0 and not measured, predicted)
    predicted.launch_mps, predicted.impact_mps = v0, hit
    flying = Plate(bare.tones, in_state(bare.mode, q, qd))
    if ratio != 0.0 and event.linked and probe.omega.shape[1] > 0:
        project_mode(last.t, start, True, Plate(bare.tones, in_state(bare.mode, last.q, last.qd)), p, probe, m)
        project_mode(start, landing, False, flying, p, probe, m)
    if not measured:
        after_q, after_qd = strike(flying.mode, landing - start, hit, p)
    elif bounces and i + 1 < n and events[i + 1].linked and not events[i + 1].relaunched:
        # measured is a ball that stays; here it leaves, and what that gives the plate comes back with it
        after_qd -= ratio / (1.0 + ratio) * rebound(hit, p) * hit
    return Chain(landing, hit, after_q, after_qd, True, chained)


@compiled
def one_ahead(
    events: NDArray[np.void], steps: Steps, acting: Acting, seen: Visibility, kick: tuple[float, float], probe: Probe,
    out: NDArray[np.void],
) -> None:  # fmt: skip
    """Predict ``events`` of `EVENT_DTYPE` into ``out`` of `PREDICTION_DTYPE`, (n,) both.

    What the plate mode does is added to the projections of ``probe``.
    ``kick``, or a part of it after a measured fade, is added to the plate mode's state wherever a chain begins.
    """
    last = Chain(np.inf, 0.0, 0.0, 0.0, False, 0)
    k, every = steps.tones.shape[1], (steps, step_lengths(steps))
    # made once: a kernel that makes an array has each reference to one counted, a tenth of the time of a flight
    room = np.empty((k, 3)), np.empty((k + 2, 6)), np.empty((k, 3))
    for i in range(len(events)):
        last = _next(i, last, events, every, acting, seen, kick, probe, room, out)


@compiled
def simulate(
    start_s: float, impact: float, period: float, tones: Floats, bare: Law, unseen_s: float, out: NDArray[np.void]
) -> int:
    """Flights one after another from an impact: fills ``out`` of `PREDICTION_DTYPE` (n,) and returns how many."""
    p = bare.p
    om, ze, _ = plate_mode(p)
    plate = Plate(tones, Mode(0.0, 0.0, om, ze, SecondMode(0.0, 0.0, 0.0, 1.0, 0.0)))
    room = np.empty((tones.shape[0] + 2, 6)), np.empty(tones.shape)
    law = Law(p, step_length(period, tones), bare.forced, bare.rubbed, *room)
    seen = Visibility(0.0, unseen_s, 0.0)
    t = start_s
    for i in range(len(out)):
        found = next_flight(t, impact, plate, law, seen, -1e300)
        if found.kind < 0:
            return i
        flown = out[i]
        flown.takeoff_s, flown.launch_mps, flown.landing_s = found.takeoff, found.launch, found.landing
        flown.impact_mps, flown.kind, flown.hidden = found.impact, found.kind, found.hidden
        q, qd = strike(in_state(plate.mode, found.q, found.qd), found.landing - found.takeoff, found.impact, p)
        plate = Plate(plate.tones, in_state(plate.mode, q, qd))
        t, impact = found.landing, found.impact
    return len(out)
