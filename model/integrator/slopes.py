"""Derivatives of what is predicted one event ahead: by earlier landings, the plate's tones and wanted parameters.

They go along the chain of flights as the predictions do: from the landing before, by way of the impact speed and the
state of a plate mode, to take-off, flight and landing. Where a prediction passes flights over, it has none.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from model.integrator.flight import LONGEST_PERIODS, flight, pull
from model.integrator.hooks import dry_friction, force, plate_mode, rebound, takeoff_threshold
from model.integrator.plate import (
    between_steps,
    loaded,
    mode_at,
    mode_under_ball,
    step_length,
    strike,
    with_state,
)
from model.integrator.predict import AS_PREDICTED, TWO_POINTS, begin_chain
from model.integrator.records import Chain, Events, Floats, Law, Mode, Plate, Steps, compiled
from model.integrator.takeoff import MOST_RESTITUTION
from model.integrator.variation import (
    LAUNCH,
    MOST_NODES,
    RATE,
    SHIFT,
    SPEED_MPS,
    TAKEOFF,
    TONES,
    Columns,
    flight_variations,
    room_for,
)

LANDING, LANDING_BEFORE, KICK, KICK_RATE = 0, 1, 2, 3
"""Places of a derivative: by the landing before, by the one before that, by the mode's displacement and velocity where
the chain began; the two quadratures of every tone follow, and after them the parameters wanted."""
INFO = 7
"""Of each event: usable or not; slope and half the relative curvature of what throws the ball, at take-off; how long
the flight lasts; relative acceleration and velocity at its end; by how much time its kind might change."""
NEAR_S = 1e-5  # differences in time of what throws the ball
SAME_S = 1e-7  # a measured flight that is flown again must land so near
AT_ONCE_MPS2 = 1e-3  # more than this, and the ball leaves at once


class Last(NamedTuple):
    """Derivatives at the last landing, (d,) each: impact speed, and the mode's state just after it."""

    hit: Floats
    q: Floats
    qd: Floats


class Leaving(NamedTuple):
    """Derivatives at take-off, (d,) each: its time and speed, and the mode's state at a fixed time."""

    off: Floats
    launch: Floats
    q: Floats
    qd: Floats


@compiled
def rest_response(t: float, tones: Floats, p: Floats, out: Floats) -> None:
    """Fill ``out`` (3, d) with the motion of a mode under a resting ball for a unit of each quadrature of each tone."""
    om, ze, ratio = plate_mode(p)
    for k in range(tones.shape[0]):
        w = tones[k, 0]
        if tones[k, 1] == 0.0 and tones[k, 2] == 0.0:
            continue
        answer = -ratio / complex(om * om - (1.0 + ratio) * w * w, 2.0 * ze * om * w)
        here = answer * complex(math.cos(w * t), math.sin(w * t))
        for part in range(2):
            x = here * (1j if part else 1.0 + 0j)
            j = TONES + 2 * k + part
            out[0, j], out[1, j], out[2, j] = x.real, (1j * w * x).real, (-w * w * x).real


@compiled
def _throws(t: float, since: float, dwell: float, plate: Plate, law: Law) -> float:
    """What throws a ball at rest at time t: positive where it leaves; ``since`` is the time from the mode's state."""
    p = law.p
    tones, mode = plate
    held = dry_friction(0.0, 0.0, 1.0, p) + takeoff_threshold(dwell, p)
    return float(pull(t, since, 0.0, tones, mode, p, law.forced) - held)


@compiled
def _at_takeoff(
    at: tuple[float, float, float, float, int, float],
    resting: Plate,
    law: Law,
    last: Last,
    columns: Columns,
    moving: Floats,
    out: Leaving,
    info: Floats,
) -> None:
    """Derivatives at a take-off from the landing before.

    ``at`` is the time of that landing, its impact speed, time and speed of the take-off, its kind, and the ball's dwell
    less the time since the landing; ``resting`` the plate with its mode's state at the landing.
    """
    t, impact, off, launched, kind, more = at
    p, c = law.p, len(columns.place)
    d = len(last.hit)
    om, ze, ratio = plate_mode(p)
    out.off[:], out.launch[:], out.q[:], out.qd[:] = 0.0, 0.0, 0.0, 0.0
    under = loaded(t, resting, p)
    moving[:] = 0.0
    velocity = np.zeros(d)
    acceleration = np.zeros(d)
    for k in range(under.tones.shape[0]):
        w = under.tones[k, 0]
        if under.tones[k, 1] == 0.0 and under.tones[k, 2] == 0.0:
            continue
        z = complex(math.cos(w * off), math.sin(w * off))
        for part in range(2):
            j = TONES + 2 * k + part
            x = z * (1j if part else 1.0 + 0j)
            acceleration[j], velocity[j] = x.real, (x / (1j * w)).real
    if ratio != 0.0:
        root = math.sqrt(1.0 + ratio)
        one = mode_at(off - t, Mode(1.0, 0.0, om / root, ze / root))
        two = mode_at(off - t, Mode(0.0, 1.0, om / root, ze / root))
        before, after = np.zeros((3, d)), np.zeros((3, d))
        rest_response(t, resting.tones, p, before)
        rest_response(off, resting.tones, p, after)
        here = mode_under_acceleration(t, resting, under, p)
        for j in range(d):
            q, qd = last.q[j], last.qd[j]
            if j == LANDING:
                q, qd = q - resting.mode.qd, qd - here
            q, qd = q - before[0, j], qd - before[1, j]
            out.q[j] = q * one[0] + qd * two[0] + after[0, j]
            out.qd[j] = q * one[1] + qd * two[1] + after[1, j]
            velocity[j] += out.qd[j]
            acceleration[j] += q * one[2] + qd * two[2] + after[2, j]
    since = off - t
    over = _throws(off, since, since + more, under, law)
    ahead = _throws(off + NEAR_S, since + NEAR_S, since + more + NEAR_S, under, law)
    behind = _throws(off - NEAR_S, since - NEAR_S, since + more - NEAR_S, under, law)
    rate, bend = 0.5 * (ahead - behind) / NEAR_S, (ahead + behind - 2.0 * over) / (NEAR_S * NEAR_S)
    info[1], info[2] = 0.0, 0.0
    if kind == 0 and over < AT_ONCE_MPS2 and rate > 0.0:
        info[1], info[2] = rate, 0.5 * bend / rate
        info[6] = since
        moves, u = 0.0, plate_velocity(off, since, under)
        if law.forced:
            moves = 0.5 * (force(0.0, 0.0, 0.0, u + SPEED_MPS, p) - force(0.0, 0.0, 0.0, u - SPEED_MPS, p)) / SPEED_MPS
        for j in range(d):
            out.off[j] = -(moves * velocity[j] - acceleration[j]) / rate
        grows = 0.5 * (takeoff_threshold(since + more + NEAR_S, p) - takeoff_threshold(since + more - NEAR_S, p))
        out.off[LANDING] -= grows / NEAR_S / rate
        for i in range(c):
            k = columns.place[i]
            kept = p[k]
            p[k] = kept + columns.change[i]
            there = force(0.0, 0.0, 0.0, u, p) - dry_friction(0.0, 0.0, 1.0, p) - takeoff_threshold(since + more, p)
            p[k] = kept
            here_too = force(0.0, 0.0, 0.0, u, p) - dry_friction(0.0, 0.0, 1.0, p) - takeoff_threshold(since + more, p)
            out.off[d - c + i] = -(there - here_too) / columns.change[i] / rate
    else:
        out.off[LANDING] = 1.0
        info[6] = abs(over / rate) if rate != 0.0 and launched == 0.0 else 1.0
    if kind == 1:
        e = rebound(impact, p)
        small = 1e-4
        steeper = 0.5 * (rebound(impact + small, p) - rebound(impact - small, p)) / small
        if 0.0 < e < MOST_RESTITUTION:
            for j in range(d):
                out.launch[j] = (e + impact * steeper) * last.hit[j]
        for i in range(c):
            k = columns.place[i]
            kept = p[k]
            p[k] = kept + columns.change[i]
            there = rebound(impact, p)
            p[k] = kept
            out.launch[d - c + i] += impact * (there - e) / columns.change[i]
    if ratio != 0.0:  # from now on it moves freely
        q, qd = mode_under_ball(t, since, resting, p)
        free = -2.0 * ze * om * qd - om * om * q
        jump = mode_under_acceleration(off, with_state(resting, q, qd), loaded(off, with_state(resting, q, qd), p), p)
        for j in range(d):
            out.qd[j] += (jump - free) * out.off[j]


@compiled
def mode_under_acceleration(t: float, resting: Plate, under: Plate, p: Floats) -> float:
    """Acceleration of the mode under a resting ball at time t, where its state is that of ``resting``."""
    a = mode_at(0.0, under.mode)[2]
    for k in range(resting.tones.shape[0]):
        w = resting.tones[k, 0]
        z = complex(under.tones[k, 1] - resting.tones[k, 1], under.tones[k, 2] - resting.tones[k, 2])
        a += (z * complex(math.cos(w * t), math.sin(w * t))).real
    return float(a)


@compiled
def plate_velocity(t: float, s: float, plate: Plate) -> float:
    """Velocity of the plate, its mode included, at time t, s after the mode's state."""
    v = mode_at(s, plate.mode)[1]
    for k in range(plate.tones.shape[0]):
        w, re, im = plate.tones[k]
        if re != 0.0 or im != 0.0:
            v += (im * math.cos(w * t) + re * math.sin(w * t)) / w
    return float(v)


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

    ``found`` (n, ...) is the table of `predict.one_ahead`; ``info`` (n, `INFO`) tells where they can be used, and what their second order is about.
    """
    n, k = len(events.landing), steps.tones.shape[1]
    d = out.shape[2]
    turning, nodes = np.empty((k + 1, 6)), np.empty((MOST_NODES, 12))
    room = room_for(k, len(columns.place))
    last = Chain(np.inf, 0.0, 0.0, 0.0, False, 0)
    carried = Last(np.zeros(d), np.zeros(d), np.zeros(d))
    leaving = Leaving(np.zeros(d), np.zeros(d), np.zeros(d), np.zeros(d))
    elementary, moving, own, hits = np.zeros((3, d)), np.zeros((3, d)), np.zeros(INFO), np.zeros(d)
    sound = True
    lengths = np.empty(len(steps.period))
    for j in range(len(lengths)):
        lengths[j] = step_length(steps.period[j], steps.tones[j])
    p = rows[0].copy()
    om, ze, ratio = plate_mode(p)
    for i in range(n):
        m, landing = events.step[i], events.landing[i]
        out[i], info[i] = 0.0, 0.0
        if len(rows) > 1:
            p[:] = rows[i]
            om, ze, ratio = plate_mode(p)
        if not events.wanted[i] and found[i, 11] == 0.0:
            last = Chain(landing, last.impact, last.q, last.qd, True, 0)
            carried.hit[:] = 0.0
            sound = True
            continue
        tones, length = steps.tones[m], lengths[m]
        if events.share[i] > 0.0:
            tones = between_steps(steps.tones, m, events.beside[i], events.share[i])
            length = step_length(steps.period[m], tones)
        bare = Plate(tones, Mode(0.0, 0.0, om, ze))
        law = Law(p, length, acting[0], acting[1], turning, nodes)
        ringing = ratio != 0.0
        if not events.linked[i]:
            before = last.t
            last = begin_chain(i, events, steps.period[m], last, bare, p)
            last = Chain(last.t, last.impact, last.q + kick[0], last.qd + kick[1], False, 0)
            carried.hit[:] = 0.0
            if ringing:
                _begun(before, last, tones, om, ze, ratio, p, carried)
            sound = True
        resting = with_state(bare, last.q, last.qd)
        # after flights passed over a ball that has come to rest remembers nothing of them
        direct = found[i, 5] == 0.0 or (found[i, 6] == 0.0 and not ringing)
        if events.wanted[i] and events.linked[i] and found[i, 6] >= 0.0 and direct and found[i, 12] == 0.0:
            off, v0, kind = found[i, 0], found[i, 1], int(found[i, 6])
            start = (last.t, last.impact, off, v0, kind, 0.0)
            _at_takeoff(start, resting, law, carried, columns, moving, leaving, info[i])
            q, qd = mode_under_ball(last.t, off - last.t, resting, p)
            nodes[0, 0] = 0.0
            flying = with_state(bare, q, qd)
            lasts, _, opened = flight(off, v0, flying, law, events.gap_m[i])
            usable, net, v = flight_variations(off, v0, opened, flying, law, ringing, columns, room, elementary)
            same = abs(off + lasts - found[i, 2]) + abs(off + max(opened, 0.0) - found[i, 4]) < SAME_S
            info[i, 0] = 1.0 if usable and sound and same else 0.0
            info[i, 3], info[i, 4], info[i, 5] = lasts, net, v
            _chained(elementary[2], leaving, out[i, 0])
            _chained(elementary[0], leaving, out[i, 1])
            _chained(elementary[1], leaving, out[i, 2])
        if found[i, 11] == 0.0:
            last = Chain(landing, last.impact, last.q, last.qd, True, 0)
            carried.hit[:], carried.q[:], carried.qd[:] = 0.0, 0.0, 0.0
            sound = True
            continue
        begun, v0, hit = found[i, 10], found[i, 7], found[i, 8]
        kind = 0 if begun > last.t else 1
        _at_takeoff((last.t, 0.0, begun, 0.0, kind, 1e9), resting, law, carried, columns, moving, leaving, own)
        leaving.launch[:] = 0.0  # it is found from both ends of the flight
        q, qd = mode_under_ball(last.t, begun - last.t, resting, p)
        flying = with_state(bare, q, qd)
        nodes[0, 0] = 0.0
        lasts, _, opened = flight(begun, v0, flying, law, 0.0)
        usable, _, _ = flight_variations(begun, v0, opened, flying, law, ringing, columns, room, elementary)
        if found[i, 11] == TWO_POINTS:
            usable = usable and abs(begun + lasts - landing) < SAME_S and elementary[0, LAUNCH] > 0.0
            _chained(elementary[0], leaving, hits)
            for j in range(d):
                leaving.launch[j] = -hits[j] / elementary[0, LAUNCH] if usable else 0.0
            _chained(elementary[1], leaving, carried.hit)
        else:
            _chained(elementary[1], leaving, carried.hit)
        own_hit = elementary[1, LAUNCH] / elementary[0, LAUNCH] if usable and found[i, 11] == TWO_POINTS else 0.0
        sound = usable and found[i, 11] != AS_PREDICTED  # weak impacts were passed there
        _after(landing - begun, hit, own_hit, flying, leaving, carried, p)
        q, qd = strike(flying.mode, landing - begun, hit, p)
        last = Chain(landing, hit, q, qd, True, 0)


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
        at.q[:], at.qd[:] = 0.0, 0.0
    at.q[LANDING : LANDING_BEFORE + 1], at.qd[LANDING : LANDING_BEFORE + 1] = 0.0, 0.0
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
        last.q[:], last.qd[:] = 0.0, 0.0
        return
    one, two = mode_at(lasts, Mode(1.0, 0.0, om, ze)), mode_at(lasts, Mode(0.0, 1.0, om, ze))
    _, rate, acceleration = mode_at(lasts, flying.mode)
    for j in range(d):
        last.q[j], last.qd[j] = at.q[j] * one[0] + at.qd[j] * two[0], at.q[j] * one[1] + at.qd[j] * two[1]
    last.q[LANDING_BEFORE], last.qd[LANDING_BEFORE] = last.q[LANDING], last.qd[LANDING]
    last.q[LANDING], last.qd[LANDING] = rate, acceleration
    small = 1e-4
    steeper = 0.5 * (rebound(hit + small, p) - rebound(hit - small, p)) / small
    share = ratio / (1.0 + ratio) * (1.0 + rebound(hit, p) + hit * steeper)
    for j in range(d):
        last.qd[j] -= share * last.hit[j]
