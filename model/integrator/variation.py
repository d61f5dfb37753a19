"""Derivatives of one flight: the variational equations along it, with the jumps at standstills and at its end.

For plates without a mode. The plate's share of a variation is known in closed form, as its motion is; only what forces
and friction add to it is integrated, on the steps of the flight itself. Partial derivatives of an effect's hook are
differences of that hook at the current state: no flight is flown twice and no event is looked for again.

References
----------
A. P. Ivanov, J. Appl. Math. Mech. 62, 677 (1998); M. di Bernardo, C. J. Budd, A. R. Champneys and P. Kowalczyk,
Piecewise-smooth Dynamical Systems (Springer, 2008), section 2.5: saltation matrices at events.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kernels.arrays import Floats
from model.integrator.flight import (
    A0,
    CONSTANT,
    DIRECTION,
    ENDED,
    FLOWN,
    GOES_ON,
    LANDS,
    NODE_S,
    STEP_S,
    _effects,
    ends_of,
    hermite5,
    standstill,
)
from model.integrator.hooks import gravity
from model.integrator.records import Law, StepEnds, clear, clear_rows, compiled

TAKEOFF, LAUNCH, TONES = 0, 1, 2
"""Places of a variation: of the take-off's time and speed; the two quadratures of every tone follow."""
MOST_NODES = 2000
HEIGHT_M, SPEED_MPS, TIME_S = 1e-7, 1e-5, 1e-6  # differences of a hook


class Room(NamedTuple):
    """Room for one flight's variations; e of them, in the order above.

    ``height`` and ``speed`` are changes of the height and of the relative velocity at the start of a segment, (e,);
    ``start`` and ``now`` the plate's displacement, velocity and acceleration, (3, e); ``carried`` (2, e) what forces
    have added so far, referred to the start of the segment; ``opening`` and ``spare`` the changes at the opening, (e,).
    """

    height: Floats
    speed: Floats
    start: Floats
    now: Floats
    carried: Floats
    opening: Floats
    spare: Floats


class Walk(NamedTuple):
    """One flight's variations under way: its take-off, the plate's tones and the law.

    ``phi`` (2, 2) is the fundamental matrix since the segment began.
    """

    t0: float
    tones: Floats
    law: Law
    room: Room
    phi: Floats


@compiled
def room_for(tones: int) -> Room:
    """Room for variations by ``tones`` tones."""
    e = TONES + 2 * tones
    wide = np.zeros((3, e)), np.zeros((3, e)), np.zeros((2, e))
    return Room(np.zeros(e), np.zeros(e), wide[0], wide[1], wide[2], np.zeros(e), np.zeros(e))


@compiled
def plate_response(t: float, tones: Floats, out: Floats) -> tuple[float, float]:
    """Fill ``out`` (3, e) with the plate's motion at time t for a unit of each tone; its velocity and acceleration."""
    velocity, acceleration = 0.0, 0.0
    for k in range(tones.shape[0]):
        w, re, im = tones[k, 0], tones[k, 1], tones[k, 2]
        j = TONES + 2 * k
        if re == 0.0 and im == 0.0:  # a place that no tone uses
            continue
        c, sn = math.cos(w * t), math.sin(w * t)
        out[2, j], out[2, j + 1] = c, -sn
        out[1, j], out[1, j + 1] = sn / w, c / w
        out[0, j], out[0, j + 1] = -c / (w * w), sn / (w * w)
        velocity += re * out[1, j] + im * out[1, j + 1]
        acceleration += re * c - im * sn
    return velocity, acceleration


@compiled
def partials(s: float, h: float, v: float, u: float, direction: float, law: Law) -> tuple[float, float, float, float]:
    """Derivatives of all forces and friction by time since take-off, height, relative and absolute velocity."""
    p, acting = law.p, (law.forced, law.rubbed)
    by_s = _effects(s + TIME_S, h, v, u, direction, p, acting) - _effects(s - TIME_S, h, v, u, direction, p, acting)
    by_h = _effects(s, h + HEIGHT_M, v, u, direction, p, acting) - _effects(s, h - HEIGHT_M, v, u, direction, p, acting)
    by_v = _effects(s, h, v + SPEED_MPS, u, direction, p, acting) - _effects(
        s, h, v - SPEED_MPS, u, direction, p, acting
    )
    by_u = 0.0
    if law.forced:
        by_u = _effects(s, h, v, u + SPEED_MPS, direction, p, acting) - _effects(
            s, h, v, u - SPEED_MPS, direction, p, acting
        )
    return 0.5 * by_s / TIME_S, 0.5 * by_h / HEIGHT_M, 0.5 * by_v / SPEED_MPS, 0.5 * by_u / SPEED_MPS


@compiled
def _turn(phi: Floats, d: float, stiff: float, loss: float) -> None:
    """Carry the fundamental matrix ``phi`` (2, 2) of ``x'' = stiff x + loss x'`` over a short time d."""
    for j in range(2):
        x, v = phi[0, j], phi[1, j]
        a1 = stiff * x + loss * v
        a2 = stiff * v + loss * a1
        a3 = stiff * a1 + loss * a2
        phi[0, j] = x + d * (v + d * (a1 / 2.0 + d * (a2 / 6.0 + d * a3 / 24.0)))
        phi[1, j] = v + d * (a1 + d * (a2 / 2.0 + d * a3 / 6.0))


@compiled
def _coasting_variations(tau: float, room: Room, height: Floats, speed: Floats) -> None:
    """Changes of height and velocity under gravity, without forces, ``tau`` after the start of the segment."""
    for e in range(len(height)):
        rate = room.start[1, e]
        height[e] = room.height[e] + room.speed[e] * tau - (room.now[0, e] - room.start[0, e] - rate * tau)
        speed[e] = room.speed[e] - (room.now[1, e] - rate)


@compiled
def _add_carried(phi: Floats, room: Room, height: Floats, speed: Floats) -> None:
    """Add what forces have carried so far, brought to where ``phi`` stands."""
    for e in range(len(height)):
        height[e] += phi[0, 0] * room.carried[0, e] + phi[0, 1] * room.carried[1, e]
        speed[e] += phi[1, 0] * room.carried[0, e] + phi[1, 1] * room.carried[1, e]


@compiled
def _carry(tau: float, weight: float, by: tuple[float, float, float, float], walk: Walk) -> None:
    """Add one node of a quadrature to ``room.carried``: the forces' changes there, brought back to the start.

    ``tau`` is the time since the start of the segment, ``by`` the `partials` there.
    """
    room, phi = walk.room, walk.phi
    by_s, by_h, by_v, by_u = by
    # variation of constants: the forces' change, taken back to the start by the inverse of phi
    det = phi[0, 0] * phi[1, 1] - phi[0, 1] * phi[1, 0]
    back_h, back_v = -weight * phi[0, 1] / det, weight * phi[0, 0] / det
    if by_h != 0.0 or by_v != 0.0 or by_u != 0.0 or by_s != 0.0:
        for e in range(len(room.height)):
            rate = room.start[1, e]
            height = room.height[e] + room.speed[e] * tau - (room.now[0, e] - room.start[0, e] - rate * tau)
            speed = room.speed[e] - (room.now[1, e] - rate)
            b = by_h * height + by_v * speed + by_u * (speed + room.now[1, e])
            if e == TAKEOFF:
                # a later take-off at a fixed motion of the plate: the forces see less time since it
                b -= by_s
            room.carried[0, e] += back_h * b
            room.carried[1, e] += back_v * b


@compiled
def _walk_part(row: Floats, ends: StepEnds, z0: float, z1: float, began: float, walk: Walk) -> None:
    """One part of a step by Simpson's rule: `_carry` at both ends and in the middle, ``phi`` carried along."""
    d, law = (z1 - z0) * row[STEP_S], walk.law
    direction = row[DIRECTION]
    if not law.rubbed:  # friction would act against the motion of this part
        direction = 1.0 if hermite5(0.5 * (z0 + z1), ends)[1] > 0.0 else -1.0
    by = (0.0, 0.0, 0.0, 0.0)
    for i in range(3):
        z = z0 + 0.5 * i * (z1 - z0)
        h, v = hermite5(z, ends)
        s = row[NODE_S] + z * row[STEP_S]
        velocity, _ = plate_response(walk.t0 + s, walk.tones, walk.room.now)
        before = by
        if row[CONSTANT] == 0.0:
            by = partials(s, h, v, v + velocity, direction, law)
        if i > 0:
            _turn(walk.phi, 0.5 * d, 0.5 * (before[1] + by[1]), 0.5 * (before[2] + before[3] + by[2] + by[3]))
        _carry(s - began, d * (4.0 if i == 1 else 1.0) / 6.0, by, walk)


@compiled
def _breaks(ends: StepEnds, until: float, opens: float, rubbed: bool) -> tuple[float, float]:
    """Up to two places within a step at which its quadrature is split: the opening, and where the motion turns."""
    turns = 2.0
    if not rubbed and (ends.v0 > 0.0) != (ends.v1 > 0.0) and ends.v0 != 0.0:
        turns = standstill(ends, 1.0)
    first, second = min(opens, turns), max(opens, turns)
    if not 0.0 < first < until:
        first, second = second, 2.0
    return first if 0.0 < first < until else 2.0, second if 0.0 < second < until else 2.0


@compiled
def _opening(tau: float, opened: float, walk: Walk) -> None:
    """Keep the change of the height at the opening, ``tau`` after the start of the segment."""
    room = walk.room
    plate_response(walk.t0 + opened, walk.tones, room.now)
    _coasting_variations(tau, room, room.opening, room.spare)
    _add_carried(walk.phi, room, room.opening, room.spare)


@compiled
def _walk_step(row: Floats, began: float, opened: float, walk: Walk) -> float:
    """Carry the variations over one step, see `model.integrator.flight.note`.

    Returns the velocity at the opening where that lies inside the step, else 0. Where forces are constant nothing has
    to be integrated.
    """
    ends = ends_of(row)
    until, opens = row[FLOWN], (opened - row[NODE_S]) / row[STEP_S] if opened > 0.0 else 2.0
    if row[CONSTANT] == 1.0:
        if 0.0 < opens < until:
            _opening(opened - began, opened, walk)
            return hermite5(opens, ends)[1]
        return 0.0
    first, second = _breaks(ends, until, opens, walk.law.rubbed)
    z, speed = 0.0, 0.0
    for stop in (first, second, until):
        if stop <= 1.0:
            _walk_part(row, ends, z, stop, began, walk)
            z = stop
            if stop == opens:
                _opening(opened - began, opened, walk)
                speed = hermite5(opens, ends)[1]
    return speed


@compiled
def _end(row: Floats, began: float, walk: Walk, height: Floats, speed: Floats) -> tuple[float, float, float]:
    """Fill the changes at the end of a segment; the time since take-off, velocity and relative acceleration there."""
    law, s = walk.law, row[NODE_S] + row[FLOWN] * row[STEP_S]
    velocity, acceleration = plate_response(walk.t0 + s, walk.tones, walk.room.now)
    _coasting_variations(s - began, walk.room, height, speed)
    _add_carried(walk.phi, walk.room, height, speed)
    h, v = hermite5(row[FLOWN], ends_of(row))
    net = -gravity(law.p) - acceleration
    if law.forced or law.rubbed:
        net += _effects(s, h, v, v + velocity, row[DIRECTION], law.p, (law.forced, law.rubbed))
    return s, v, net


@compiled
def flight_variations(
    t0: float, v0: float, opened: float, tones: Floats, law: Law, room: Room, out: Floats
) -> tuple[bool, float, float]:
    """Derivatives of a flight whose steps stand in ``law.nodes``: of its end, impact speed and opening, ``out`` (3, e).

    The take-off's time is varied at a fixed motion of the plate. ``opened`` is the time from take-off to opening.
    Returns whether they can be used, and acceleration and velocity at the end.
    """
    nodes, count = law.nodes, int(law.nodes[0, 0])
    if count == 0 or count >= nodes.shape[0] or nodes[count, ENDED] != LANDS:
        return False, 0.0, 0.0
    clear(room.height)
    clear(room.speed)
    clear_rows(room.start)
    clear_rows(room.now)
    # a take-off later by dt finds the plate v0 dt nearer and the speed h'' dt behind
    room.height[TAKEOFF], room.speed[TAKEOFF], room.speed[LAUNCH] = -v0, -nodes[1, A0], 1.0
    walk = Walk(t0, tones, law, room, np.empty((2, 2)))
    height, speed = np.empty(len(room.height)), np.empty(len(room.height))
    opening_speed, began, begins = 0.0, 0.0, True
    for r in range(1, count + 1):
        row = nodes[r]
        if begins:
            began = row[NODE_S]
            plate_response(t0 + began, tones, room.start)
            clear_rows(walk.phi)
            walk.phi[0, 0], walk.phi[1, 1] = 1.0, 1.0
            clear_rows(room.carried)
        opening_speed += _walk_step(row, began, opened, walk)
        begins = row[ENDED] != GOES_ON
        if not begins:
            continue
        s, v, net = _end(row, began, walk, height, speed)
        if row[ENDED] == LANDS:
            return v < 0.0 and _landed(height, speed, v, net, opening_speed, room, out), net, v
        # with no change of acceleration the standstill moves without bound: a graze has no derivative
        if abs(net) < 1e-6:
            return False, net, v
        # a ball that was held leaves when forces let it: the variation of its speed is gone
        # a standstill that lasts is a hang: the release does not know when the ball stopped
        left = nodes[r + 1, A0] / net if nodes[r + 1, NODE_S] - s <= 1e-12 else 0.0
        for e in range(len(height)):
            room.height[e], room.speed[e] = height[e], left * speed[e]
    return False, 0.0, 0.0


@compiled
def _landed(height: Floats, speed: Floats, v: float, net: float, opening_speed: float, room: Room, out: Floats) -> bool:
    """Derivatives ``out`` (3, e) at an impact at velocity ``v`` and relative acceleration ``net``."""
    for i in range(len(height)):
        # the landing shifts by what the height lacks over the speed; the impact speed changes on the way as well
        out[0, i] = -height[i] / v
        out[1, i] = -(speed[i] + net * out[0, i])
        out[2, i] = -room.opening[i] / opening_speed if opening_speed > 0.0 else 0.0
    if not opening_speed > 0.0:
        out[2, TAKEOFF] = 1.0
    return True
