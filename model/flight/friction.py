"""Flights with Coulomb friction and restitution, compiled: rise, hang, fall, rebound, chatter, each in closed form.

The rule kept here: between events no step is taken, and the events are proven first. Going up only ``h' = 0`` can end
the stage, because the height grows; falling the height is monotone, so the plate and the standstill are looked for
branch by branch; a standing ball hangs while it lies inside a window of the falling level and outside one of the rising
level. ``up`` and ``down`` are the tables of `model.flight.branches` at the levels ``1 + mu_up`` and ``1 - mu_down``.
"""

from __future__ import annotations

import math

import numpy as np

from model.flight.branches import TWO_PI, branch_of, fill_edges, fold
from model.flight.chatter import tail_of_chatter
from model.flight.ideal import RESET, RESTS
from model.flight.numerics import Flags, Floats, compiled
from model.flight.segment import (
    UNDECIDED,
    Segment,
    motion,
    root_in_concave,
    root_in_convex,
    stage_from,
    standstill,
    surely_above,
    total_speed,
)
from model.flight.short_bounce import short_bounce

HUNG = 8
CHATTERED = 16
MOST_STAGES = 100_000  # ups, hangs and falls in one flight; beyond it the ball is said to stay on the rod

FrictionRestitution = tuple[float, float, float, float]  # mu_up, mu_down, e0, e1


@compiled
def fill_rough_edges(
    tones: Floats, turning: Floats, gamma: float, rough: FrictionRestitution, up: Floats, down: Floats
) -> tuple[int, int]:
    """Fill the tables of both levels (each ``(len(turning) + 2,)``) and return their numbers of windows."""
    n_up = fill_edges(tones, turning, gamma / (1.0 + rough[0]), up)
    n_down = fill_edges(tones, turning, gamma / (1.0 - rough[1]), down)
    return n_up, n_down


@compiled
def rise(tones: Floats, gamma: float, up: Floats, n_up: int, stage: Segment) -> tuple[float, float]:
    """Time and phase at which a rising ball first stands still relative to the plate."""
    phi0, _, slope0, a0, v0, _, level = stage
    fastest = total_speed(tones)
    sure = max((v0 + gamma * (slope0 - fastest)) / level, 0.0)  # rising at least so long
    if n_up == 0:
        last = (v0 + gamma * (slope0 + fastest)) / level
        x = standstill(tones, gamma, stage, 0.0, phi0, phi0 + last, min(phi0 + v0 / -a0, phi0 + last), False)
        return x - phi0, x
    lo = fold(phi0 + sure, up[0])
    turns = TWO_PI * np.rint((phi0 + sure - lo) / TWO_PI)
    i = branch_of(up, n_up, lo)
    while True:
        hi = up[i + 1]
        if i % 2 == 1 and motion(tones, gamma, stage, hi, hi - phi0 + turns)[1] <= 0.0:
            guess = lo + v0 / -a0 if a0 < 0.0 and lo == phi0 else 0.5 * (lo + hi)
            x = standstill(tones, gamma, stage, turns, lo, hi, guess, False)
            return x - phi0 + turns, x
        i += 1
        if i == 2 * n_up:
            i = 0
            turns += TWO_PI
        lo = up[i]


@compiled
def _fall_for_ever(tones: Floats, gamma: float, stage: Segment) -> tuple[bool, float, float, float, int]:
    """`fall` where the plate never stops a falling ball: one concave branch, any point below ends the bracket."""
    reach = 1.0
    while motion(tones, gamma, stage, stage[0] + reach, reach)[0] > 0.0:
        reach *= 2.0
    guess = stage[0] + min(math.sqrt(max(2.0 * stage[5] / -stage[3], 0.0)), reach)
    x, speed = root_in_concave(tones, gamma, stage, 0.0, stage[0], stage[0] + reach, guess)
    return True, x - stage[0], x, speed, 0


@compiled
def fall(
    tones: Floats, gamma: float, down: Floats, n_down: int, stage: Segment
) -> tuple[bool, float, float, float, int]:
    """A fall from a standstill: ``(landed, time, phase, impact speed, flag)``; not landed means that it stood still."""
    phi0 = stage[0]
    if n_down == 0:
        return _fall_for_ever(tones, gamma, stage)
    safe_from, safe_to = surely_above(tones, gamma, stage)
    safe_from = max(safe_from, (stage[4] + gamma * (stage[2] + total_speed(tones))) / stage[6])  # and surely falling
    lo = phi0
    i = branch_of(down, n_down, lo)
    turns = 0.0
    flag = 0
    while True:
        hi = down[i + 1]
        tau = hi - phi0 + turns
        h, v, _ = motion(tones, gamma, stage, hi, tau)
        if i % 2 == 1:
            if h <= 0.0:
                guess = lo + math.sqrt(2.0 * stage[5] / -stage[3]) if lo == phi0 and stage[3] < 0.0 else 0.5 * (lo + hi)
                x, speed = root_in_concave(tones, gamma, stage, turns, lo, hi, guess)
                return True, x - phi0 + turns, x, speed, flag
            if safe_from < tau < safe_to - TWO_PI:
                turns += TWO_PI * math.floor((safe_to - tau) / TWO_PI)
        elif h <= 0.0 or v >= 0.0:
            found, x, speed, graze = root_in_convex(tones, gamma, stage, turns, lo, hi)
            flag |= graze
            if not found:
                speed = 0.0
                x = standstill(tones, gamma, stage, turns, lo, hi, hi, True)
            return found, x - phi0 + turns, x, speed, flag
        i += 1
        if i == 2 * n_down:
            i = 0
            turns += TWO_PI
        lo = down[i]


@compiled
def hang(up: Floats, n_up: int, down: Floats, n_down: int, phi: float) -> tuple[bool, float, float, bool]:
    """What a ball standing in mid-air at ``phi`` does next: ``(rises, waiting time, phase, at a threshold)``."""
    if n_down == 0:
        return False, 0.0, phi, False
    at = fold(phi, down[0])
    i = branch_of(down, n_down, at)
    if i % 2 == 1:
        return False, 0.0, at, False
    wait = down[i + 1] - at
    if n_up > 0:
        at_up = fold(phi, up[0])
        k = branch_of(up, n_up, at_up)
        if k % 2 == 0:
            return True, 0.0, at_up, False
        if up[k + 1] - at_up < wait:
            return True, up[k + 1] - at_up, fold(up[k + 1], up[0]), True
    return False, wait, fold(down[i + 1], down[0]), True


@compiled
def rough_land(
    tones: Floats,
    gamma: float,
    up: Floats,
    n_up: int,
    down: Floats,
    n_down: int,
    rough: FrictionRestitution,
    phi0: float,
    v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, int]:
    """One flight of the rough ball from the take-off at ``phi0`` with relative speed ``v0``.

    Returns
    -------
    tau (hanging included), landing phase (any turn), impact speed, flag
        tau is inf, flag RESTS, when the ball stays on the rod.
    """
    if v0 > 0.0:
        short, tau, speed = short_bounce(tones, gamma, rough, phi0, v0)
        if short:
            return tau, phi0 + tau, speed, 0
    at = fold(phi0, up[0]) if n_up > 0 else phi0
    stage = stage_from(tones, gamma, at, v0, 0.0, 1.0 + rough[0], at_threshold)
    rising = True
    total = 0.0
    flag = 0
    for _ in range(MOST_STAGES):
        if rising:
            tau, phi = rise(tones, gamma, up, n_up, stage)
        else:
            landed, tau, phi, speed, graze = fall(tones, gamma, down, n_down, stage)
            flag |= graze
            if landed:
                return total + tau, phi, speed, flag
        h, v, _ = motion(tones, gamma, stage, phi, tau)
        if h <= 0.0:  # lifted by less than rounding
            return total + tau, phi, 0.0, flag | UNDECIDED
        rising, wait, phi, at_edge = hang(up, n_up, down, n_down, phi)
        if wait > 0.0:
            flag |= HUNG
            v = 0.0
        total += tau + wait
        level = 1.0 + rough[0] if rising else 1.0 - rough[1]
        stage = stage_from(tones, gamma, phi, v, h, level, at_edge)  # v is what rounding left of a standstill
    return math.inf, phi, 0.0, flag | RESTS


@compiled
def rebound(rough: FrictionRestitution, speed: float) -> float:
    """Speed after an impact at ``speed``: ``e0 - e1 speed`` of it, at least none and at most all."""
    return speed * min(max(rough[2] - rough[3] * speed, 0.0), 1.0)


@compiled
def rough_take_off(up: Floats, n_up: int, phi: float, v: float) -> tuple[float, bool]:
    """Where a ball on the plate at ``phi``, rebounding with ``v``, leaves: ``(phase, from rest at a threshold)``."""
    at = fold(phi, up[0])
    if v > 0.0:
        return at, False
    i = branch_of(up, n_up, at)
    if i % 2 == 0 and at > up[i]:
        return at, False
    return up[2 * (((i + 1) // 2) % n_up)], True


@compiled
def rough_orbit(
    tones: Floats,
    gamma: float,
    up: Floats,
    n_up: int,
    down: Floats,
    n_down: int,
    rough: FrictionRestitution,
    phi: float,
    v: float,
    n_transient: int,
    taus: Floats,
    phases: Floats,
    speeds: Floats,
    rest_taus: Floats,
    flags: Flags,
) -> tuple[float, float]:
    """Fly from the plate at ``phi`` with rebound speed ``v``: ``n_transient`` flights, then as many as arrays hold.

    Fills flight times, take-off phases (in [0, 2 pi)), impact speeds, times from landing to rest by chatter (else NaN)
    and flags; returns the last landing's ``(phase, rebound speed)``, from which the orbit goes on.
    """
    for k in range(-n_transient, taus.shape[0]):
        reset = False
        tau, speed, flag = 0.0, 0.0, RESTS
        rest_tau = math.nan
        if n_up > 0 or v > 0.0:
            phi0, reset = rough_take_off(up, n_up, phi, v) if n_up > 0 else (phi, False)
            tau, phi, speed, flag = rough_land(tones, gamma, up, n_up, down, n_down, rough, phi0, v, reset)
            v = rebound(rough, speed)
            if v > 0.0:
                tail = tail_of_chatter(tones, gamma, rough, phi, v)
                if tail >= 0.0:
                    rest_tau = tail
                    phi += tail
                    v = 0.0
                    flag |= CHATTERED
            phi = fold(phi, 0.0)
        else:
            phi0 = phi
        if k >= 0:
            taus[k] = tau
            phases[k] = fold(phi0, 0.0)
            speeds[k] = speed
            rest_taus[k] = rest_tau
            flags[k] = flag | (RESET if reset else 0)
    return phi, v
