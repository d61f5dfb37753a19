"""Derivatives of a take-off by the landing before, its impact speed, a mode's state, tones and parameters."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from model.integrator.flight import pull
from model.integrator.hooks import dry_friction, force, plate_mode, rebound, takeoff_threshold
from model.integrator.plate import loaded, mode_at, mode_under_ball, with_state
from model.integrator.records import Floats, Law, Mode, Plate, clear, compiled
from model.integrator.takeoff import MOST_RESTITUTION
from model.integrator.variation import SPEED_MPS, TONES, Columns

LANDING, LANDING_BEFORE, KICK, KICK_RATE = 0, 1, 2, 3
"""Places of a derivative: by the landing before, by the one before that, by the mode's displacement and velocity where
the chain began; the two quadratures of every tone follow, and after them the parameters wanted."""
INFO = 7
"""Of each event: usable or not; slope and half the relative curvature of what throws the ball, at take-off; how long
the flight lasts; relative acceleration and velocity at its end; by how much time its kind might change."""
FASTER_MPS = 1e-4  # difference of an impact speed
NEAR_S = 1e-5  # differences in time of what throws the ball
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


class Work(NamedTuple):
    """Room for the derivatives of one event: d of them, e of one flight by its own start.

    Plate's velocity and acceleration at a take-off (d,); a mode's motion under the ball at its landing and then,
    (3, d); landings (d,); the take-off; derivatives of a flight (3, e); its `INFO`.
    """

    velocity: Floats
    acceleration: Floats
    before: Floats
    after: Floats
    hits: Floats
    leaving: Leaving
    elementary: Floats
    info: Floats


@compiled
def work_for(d: int) -> Work:
    """Room for ``d`` derivatives: as many as a flight has by its own start."""
    leaving = Leaving(np.zeros(d), np.zeros(d), np.zeros(d), np.zeros(d))
    both = np.zeros((3, d)), np.zeros((3, d))
    return Work(np.zeros(d), np.zeros(d), both[0], both[1], np.zeros(d), leaving, np.zeros((3, d)), np.zeros(INFO))


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
def at_takeoff(
    at: tuple[float, float, float, float, int, float],
    resting: Plate,
    law: Law,
    last: Last,
    columns: Columns,
    work: Work,
    out: Leaving,
    info: Floats,
) -> None:
    """Derivatives at a take-off from the landing before.

    ``at`` is the time of that landing, its impact speed, time and speed of the take-off, its kind, and the ball's dwell
    less the time since the landing; ``resting`` the plate with its mode's state at the landing.
    """
    t, impact, off, launched, kind, more = at
    p, since = law.p, off - t
    clear(out.off)
    clear(out.launch)
    clear(out.q)
    clear(out.qd)
    under = loaded(t, resting, p)
    _plate_at(off, under.tones, work)
    ratio = plate_mode(p)[2]
    if ratio != 0.0:
        _mode_at(t, off, resting, under, last, work, out, p)
    over = _throws(off, since, since + more, under, law)
    ahead = _throws(off + NEAR_S, since + NEAR_S, since + more + NEAR_S, under, law)
    behind = _throws(off - NEAR_S, since - NEAR_S, since + more - NEAR_S, under, law)
    rate, bend = 0.5 * (ahead - behind) / NEAR_S, (ahead + behind - 2.0 * over) / (NEAR_S * NEAR_S)
    info[1], info[2] = 0.0, 0.0
    if kind == 0 and over < AT_ONCE_MPS2 and rate > 0.0:
        info[1], info[2], info[6] = rate, 0.5 * bend / rate, since
        _when_thrown(off, since, since + more, rate, under, law, columns, work, out)
    else:
        out.off[LANDING] = 1.0
        info[6] = abs(over / rate) if rate != 0.0 and launched == 0.0 else 1.0
    if kind == 1:
        _rebounds(impact, last, columns, out, p)
    if ratio != 0.0:  # from now on it moves freely
        q, qd = mode_under_ball(t, since, resting, p)
        om, ze, _ = plate_mode(p)
        free = -2.0 * ze * om * qd - om * om * q
        here = with_state(resting, q, qd)
        jump = mode_under_acceleration(off, here, loaded(off, here, p), p)
        for j in range(len(out.qd)):
            out.qd[j] += (jump - free) * out.off[j]


@compiled
def _plate_at(off: float, tones: Floats, work: Work) -> None:
    """Derivatives of the plate's velocity and acceleration at a take-off by its tones."""
    clear(work.velocity)
    clear(work.acceleration)
    for k in range(tones.shape[0]):
        w = tones[k, 0]
        if tones[k, 1] == 0.0 and tones[k, 2] == 0.0:
            continue
        z = complex(math.cos(w * off), math.sin(w * off))
        for part in range(2):
            j = TONES + 2 * k + part
            x = z * (1j if part else 1.0 + 0j)
            work.acceleration[j], work.velocity[j] = x.real, (x / (1j * w)).real


@compiled
def _mode_at(
    t: float, off: float, resting: Plate, under: Plate, last: Last, work: Work, out: Leaving, p: Floats
) -> None:
    """Derivatives of the mode's state at a take-off, and its share in those of the plate; a ball rests on it from t."""
    om, ze, ratio = plate_mode(p)
    root = math.sqrt(1.0 + ratio)
    one = mode_at(off - t, Mode(1.0, 0.0, om / root, ze / root))
    two = mode_at(off - t, Mode(0.0, 1.0, om / root, ze / root))
    rest_response(t, resting.tones, p, work.before)
    rest_response(off, resting.tones, p, work.after)
    here = mode_under_acceleration(t, resting, under, p)
    before, after = work.before, work.after
    for j in range(len(last.q)):
        q, qd = last.q[j], last.qd[j]
        if j == LANDING:
            q, qd = q - resting.mode.qd, qd - here
        q, qd = q - before[0, j], qd - before[1, j]
        out.q[j] = q * one[0] + qd * two[0] + after[0, j]
        out.qd[j] = q * one[1] + qd * two[1] + after[1, j]
        work.velocity[j] += out.qd[j]
        work.acceleration[j] += q * one[2] + qd * two[2] + after[2, j]


@compiled
def _when_thrown(
    off: float,
    since: float,
    dwell: float,
    rate: float,
    under: Plate,
    law: Law,
    columns: Columns,
    work: Work,
    out: Leaving,
) -> None:
    """Derivatives of the time at which a ball at rest is thrown; ``rate`` is the slope of what throws it."""
    p, c, d = law.p, len(columns.place), len(out.off)
    moves, u = 0.0, plate_velocity(off, since, under)
    if law.forced:
        moves = 0.5 * (force(0.0, 0.0, 0.0, u + SPEED_MPS, p) - force(0.0, 0.0, 0.0, u - SPEED_MPS, p)) / SPEED_MPS
    for j in range(d):
        out.off[j] = -(moves * work.velocity[j] - work.acceleration[j]) / rate
    grows = 0.5 * (takeoff_threshold(dwell + NEAR_S, p) - takeoff_threshold(dwell - NEAR_S, p)) / NEAR_S
    out.off[LANDING] -= grows / rate
    base = force(0.0, 0.0, 0.0, u, p) - dry_friction(0.0, 0.0, 1.0, p) - takeoff_threshold(dwell, p)
    for i in range(c):
        k = columns.place[i]
        kept = p[k]
        p[k] = kept + columns.change[i]
        there = force(0.0, 0.0, 0.0, u, p) - dry_friction(0.0, 0.0, 1.0, p) - takeoff_threshold(dwell, p)
        p[k] = kept
        out.off[d - c + i] = -(there - base) / columns.change[i] / rate


@compiled
def steeper(impact: float, p: Floats) -> float:
    """Derivative of the coefficient of restitution by the impact speed."""
    return float(0.5 * (rebound(impact + FASTER_MPS, p) - rebound(impact - FASTER_MPS, p)) / FASTER_MPS)


@compiled
def _rebounds(impact: float, last: Last, columns: Columns, out: Leaving, p: Floats) -> None:
    """Derivatives of the speed with which the ball leaves an impact."""
    e, d, c = rebound(impact, p), len(out.launch), len(columns.place)
    if 0.0 < e < MOST_RESTITUTION:
        rate = e + impact * steeper(impact, p)
        for j in range(d):
            out.launch[j] = rate * last.hit[j]
    for i in range(c):
        k = columns.place[i]
        kept = p[k]
        p[k] = kept + columns.change[i]
        out.launch[d - c + i] += impact * (rebound(impact, p) - e) / columns.change[i]
        p[k] = kept


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
