"""Derivatives of a take-off by the landing before, its impact speed and tones: plates without a mode."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kernels.arrays import Floats
from model.integrator.flight import pull
from model.integrator.hooks import dry_friction, force, rebound, takeoff_threshold
from model.integrator.plate import tones_at
from model.integrator.records import Law, Plate, clear, compiled
from model.integrator.takeoff import MOST_RESTITUTION
from model.integrator.variation import SPEED_MPS, TONES

LANDING, LANDING_BEFORE = 0, 1
"""Places of a derivative: by the landing before and by the one before that; both quadratures of every tone follow."""
INFO = 7
"""Of each event: usable or not; slope and half the relative curvature of what throws the ball, at take-off; how long
the flight lasts; relative acceleration and velocity at its end; by how much time its kind might change."""
FASTER_MPS = 1e-4  # difference of an impact speed
NEAR_S = 1e-5  # differences in time of what throws the ball
AT_ONCE_MPS2 = 1e-3  # more than this, and the ball leaves at once


class Leaving(NamedTuple):
    """Derivatives at take-off, (d,) each: its time and speed."""

    off: Floats
    launch: Floats


class Work(NamedTuple):
    """Room for the d derivatives of one event.

    Plate's acceleration at a take-off, and its velocity (d,); landings (d,); the take-off; derivatives of a flight by
    its own start (3, d); its `INFO`.
    """

    velocity: Floats
    acceleration: Floats
    hits: Floats
    leaving: Leaving
    elementary: Floats
    info: Floats


@compiled
def work_for(d: int) -> Work:
    """Room for ``d`` derivatives: as many as a flight has by its own start."""
    leaving = Leaving(np.zeros(d), np.zeros(d))
    return Work(np.zeros(d), np.zeros(d), np.zeros(d), leaving, np.zeros((3, d)), np.zeros(INFO))


@compiled
def _throws(t: float, dwell: float, plate: Plate, law: Law) -> float:
    """What throws a ball at rest at time t: positive where it leaves."""
    p, (tones, mode) = law.p, plate
    held = dry_friction(0.0, 0.0, 1.0, p) + takeoff_threshold(dwell, p)
    return float(pull(t, 0.0, 0.0, tones, mode, p, law.forced) - held)


@compiled
def at_takeoff(
    at: tuple[float, float, float, float, int, float],
    plate: Plate,
    law: Law,
    hit: Floats,
    work: Work,
    out: Leaving,
    info: Floats,
) -> None:
    """Derivatives at a take-off from the landing before.

    ``at`` is the time of that landing, its impact speed, time and speed of the take-off, its kind, and the ball's dwell
    less the time since the landing; ``hit`` (d,) the derivatives of the impact speed.
    """
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
    if kind == 0 and over < AT_ONCE_MPS2 and rate > 0.0:
        info[1], info[2], info[6] = rate, 0.5 * bend / rate, since
        _when_thrown(off, since + more, rate, plate, law, work, out)
    else:
        out.off[LANDING] = 1.0
        info[6] = abs(over / rate) if rate != 0.0 and launched == 0.0 else 1.0
    if kind == 1:
        _rebounds(impact, hit, out, law.p)


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
        out.off[j] = -(moves * work.velocity[j] - work.acceleration[j]) / rate
    grows = 0.5 * (takeoff_threshold(dwell + NEAR_S, p) - takeoff_threshold(dwell - NEAR_S, p)) / NEAR_S
    out.off[LANDING] -= grows / rate


@compiled
def steeper(impact: float, p: Floats) -> float:
    """Derivative of the coefficient of restitution by the impact speed."""
    return float(0.5 * (rebound(impact + FASTER_MPS, p) - rebound(impact - FASTER_MPS, p)) / FASTER_MPS)


@compiled
def _rebounds(impact: float, hit: Floats, out: Leaving, p: Floats) -> None:
    """Derivatives of the speed with which the ball leaves an impact."""
    e = rebound(impact, p)
    if 0.0 < e < MOST_RESTITUTION:
        rate = e + impact * steeper(impact, p)
        for j in range(len(out.launch)):
            out.launch[j] = rate * hit[j]
