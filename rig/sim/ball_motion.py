"""The ball's motion through one interval between samples, event by event.

A Runge-Kutta step never straddles a kink. Take-off, apex under friction, landing and the end
of a hang are located inside the step on its quintic Hermite interpolant (or on the force itself), the state is
moved there exactly, and the rest of the interval is stepped anew. Decision 33.
"""

from __future__ import annotations

import math
from typing import Any

from kernels import njit
from rig.sim.forces import gravity, hang_margin, net, plate_acceleration, rebound, release_margin
from rig.sim.state import CONTACT, FLIGHT, HANGING, OPEN, landing_edges, push_edge, ring_now, uniform

_THIRD, _SIXTH = 1.0 / 3.0, 1.0 / 6.0


@njit()
def _slope(s: Any, p: Any, h: float, v: float, u: float, y: float, yv: float) -> tuple[float, float, float, float]:
    """Time derivatives of height, relative speed, mode displacement and mode speed."""
    flying = s.state == FLIGHT
    ydd = plate_acceleration(s, p, u, y, yv, not flying)[1] if p.has_mode != 0.0 else 0.0
    if flying:
        return v, net(s, p, h, v, u, y, yv), yv, ydd
    return 0.0, 0.0, yv, ydd


@njit()
def _ballistic(s: Any, p: Any, step_s: float) -> tuple[float, float, float, float]:
    """Exact step where weight and constant friction are all that acts: the plate's cubic integrated twice."""
    u, du = s.u, step_s / s.dt_s
    b0 = net(s, p, s.height_m, s.speed_mps, u, 0.0, 0.0)
    b1 = -du * (s.a1 + u * (2.0 * s.a2 + 3.0 * u * s.a3))
    b2 = -du * du * (s.a2 + 3.0 * u * s.a3)
    b3 = -du * du * du * s.a3
    v = s.speed_mps + step_s * (b0 + b1 / 2.0 + b2 / 3.0 + b3 / 4.0)
    h = s.height_m + step_s * (s.speed_mps + step_s * (b0 / 2.0 + b1 / 6.0 + b2 / 12.0 + b3 / 20.0))
    return h, v, s.mode_m, s.mode_mps


@njit()
def _step(s: Any, p: Any, step_s: float) -> tuple[float, float, float, float]:
    """State (height, speed, mode, mode speed) one step later: exact where it can be, else Runge-Kutta of order 4."""
    h, v, y, yv, u = s.height_m, s.speed_mps, s.mode_m, s.mode_mps, s.u
    if p.is_ballistic != 0.0 and s.state == FLIGHT:
        return _ballistic(s, p, step_s)
    half, du = 0.5 * step_s, step_s / s.dt_s
    a1, b1, c1, d1 = _slope(s, p, h, v, u, y, yv)
    a2, b2, c2, d2 = _slope(s, p, h + half * a1, v + half * b1, u + 0.5 * du, y + half * c1, yv + half * d1)
    a3, b3, c3, d3 = _slope(s, p, h + half * a2, v + half * b2, u + 0.5 * du, y + half * c2, yv + half * d2)
    a4, b4, c4, d4 = _slope(s, p, h + step_s * a3, v + step_s * b3, u + du, y + step_s * c3, yv + step_s * d3)
    k = step_s / 6.0
    return (
        h + k * (a1 + 2.0 * (a2 + a3) + a4),
        v + k * (b1 + 2.0 * (b2 + b3) + b4),
        y + k * (c1 + 2.0 * (c2 + c3) + c4),
        yv + k * (d1 + 2.0 * (d2 + d3) + d4),
    )


@njit()
def _hermite(
    h0: float, v0: float, a0: float, h1: float, v1: float, a1: float, step: float
) -> tuple[float, float, float, float, float, float]:
    """Quintic through height, speed and acceleration at both ends, as powers of ``x`` = time / step."""
    v0, v1, a0, a1 = v0 * step, v1 * step, a0 * step * step, a1 * step * step
    d, dv, da = h1 - h0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    return (h0, v0, 0.5 * a0, 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da)


@njit()
def _height(c: Any, x: float) -> float:
    return float(c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5])))))


@njit()
def _speed(c: Any, x: float) -> float:
    return float(c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + x * (4.0 * c[4] + x * 5.0 * c[5]))))


@njit()
def _root(c: Any, lo: float, hi: float, of_speed: bool, level: float) -> float:
    """Where height (or speed) crosses ``level`` between ``lo`` and ``hi``, by bisection and secant."""
    f_lo = (_speed(c, lo) if of_speed else _height(c, lo)) - level
    f_hi = (_speed(c, hi) if of_speed else _height(c, hi)) - level
    for k in range(100):
        x = 0.5 * (lo + hi)
        if k % 3 != 2 and f_hi != f_lo:
            secant = lo - f_lo * (hi - lo) / (f_hi - f_lo)
            if lo < secant < hi:
                x = secant
        f = (_speed(c, x) if of_speed else _height(c, x)) - level
        if f == 0.0:
            return x
        if (f > 0.0) == (f_lo > 0.0):
            lo, f_lo = x, f
        else:
            hi, f_hi = x, f
        if hi - lo < 1e-13:
            break
    return hi


@njit()
def _margin(s: Any, p: Any, u: float) -> float:
    """How far the resting ball is from moving at ``u``; the mode is carried there by Taylor's rule."""
    tau = (u - s.u) * s.dt_s
    y, yv = s.mode_m, s.mode_mps
    if p.has_mode != 0.0:
        ydd = plate_acceleration(s, p, s.u, y, yv, True)[1]
        y, yv = y + tau * (yv + 0.5 * tau * ydd), yv + tau * ydd
    if s.state == CONTACT:
        return release_margin(s, p, u, y, yv)
    return hang_margin(s, p, u, y, yv)


@njit()
def _move_to(s: Any, u: float, h: float, v: float, y: float, yv: float) -> None:
    s.u, s.height_m, s.speed_mps, s.mode_m, s.mode_mps = u, h, v, y, yv


@njit()
def _leave(s: Any, p: Any, v: float) -> None:
    """The ball leaves the plate with relative speed ``v`` >= 0."""
    t = s.t_s + s.u * s.dt_s
    s.state, s.direction, s.speed_mps, s.height_m, s.left_s = FLIGHT, 1, v, 0.0, t
    if p.contact_gap_gap_m == 0.0:
        s.commanded_open = 1
        push_edge(s, p, t, OPEN)
    else:
        s.commanded_open = 0


@njit()
def _settle(s: Any, p: Any, v: float) -> None:
    """Right after an impact at the plate, rebounding with ``v``: fly again, be launched again, or rest."""
    s.state, s.direction, s.height_m, s.speed_mps = FLIGHT, 1, 0.0, v
    a = net(s, p, 0.0, v, s.u, s.mode_m, s.mode_mps)
    # a rebound that would be over within a microsecond has converged: the ball rests
    if v > 0.0 and (a >= 0.0 or 2.0 * v > -a * 1e-6):
        _leave(s, p, v)
        return
    s.state, s.speed_mps, s.contact_since_s = CONTACT, 0.0, s.t_s + s.u * s.dt_s
    if _margin(s, p, s.u) > 0.0:
        _leave(s, p, 0.0)


@njit()
def _land(s: Any, p: Any, v: float) -> None:
    """Impact with relative speed ``v`` <= 0 at the current place: recoil of the table, ringing, rebound."""
    t, impact = s.t_s + s.u * s.dt_s, max(-v, 0.0)
    chance = uniform(s) if p.scattered_restitution_e > 0.0 or p.restitution_scatter_sd > 0.0 else 0.5
    e = rebound(s, p, impact, chance)
    if p.rod_rocking_mu > 0.0:
        # an impact at 0.5 m/s sets the block rocking by one unit
        s.rocking = s.rocking * math.exp(-(t - s.landed_s) / p.rod_rocking_decay_s) + impact / 0.5
    s.flight_s, s.landed_s = t - s.left_s, t
    s.impacts += 1
    s.parity = 1 - s.parity
    if p.has_mode != 0.0:
        share = p.table_resonance_mass_ratio
        # momentum of the ball and the mode's mass
        s.mode_mps -= share / (1.0 + share) * (1.0 + e) * impact
    landing_edges(s, p, t)
    s.hold_until_s = t + p.impact_hold_hold_s_per_mps * impact
    ring_now(s, p, impact * (1.0 + e))
    _settle(s, p, e * impact)


@njit()
def _fly(s: Any, p: Any) -> None:
    """One flight step: to the end of the interval, or to the first event before it."""
    step = (1.0 - s.u) * s.dt_s
    h0, v0 = s.height_m, s.speed_mps
    h1, v1, y1, yv1 = _step(s, p, step)
    turned = p.has_friction != 0.0 and s.direction * v1 < 0.0
    # a fall that turned within the step may have touched the plate in between
    dipped = v0 < 0.0 and v1 > 0.0 and h1 >= 0.0 and h0 + 0.5 * step * v0 < 0.0
    if h1 >= 0.0 and not turned and not dipped:
        if s.commanded_open == 0 and h1 > p.contact_gap_gap_m:
            a0, a1 = net(s, p, h0, v0, s.u, s.mode_m, s.mode_mps), net(s, p, h1, v1, 1.0, y1, yv1)
            if h0 <= p.contact_gap_gap_m:  # the circuit opens where the ball rises through the gap
                s.commanded_open = 1
                x = _root(_hermite(h0, v0, a0, h1, v1, a1, step), 0.0, 1.0, False, p.contact_gap_gap_m)
                push_edge(s, p, s.t_s + s.u * s.dt_s + x * step, OPEN)
        _move_to(s, 1.0, h1, v1, y1, yv1)
        return
    a0, a1 = net(s, p, h0, v0, s.u, s.mode_m, s.mode_mps), net(s, p, h1, v1, 1.0, y1, yv1)
    c = _hermite(h0, v0, a0, h1, v1, a1, step)
    apex = 0.0 if v0 <= 0.0 else 1.0
    if v0 * v1 < 0.0:
        apex = _root(c, 0.0, 1.0, True, 0.0)
    landing = 2.0
    if dipped:
        landing = _root(c, 0.0, apex, False, 0.0) if _height(c, apex) < 0.0 else 2.0
    elif h1 < 0.0:
        landing = _root(c, apex if v0 > 0.0 else 0.0, 1.0, False, 0.0)
    if turned and apex < landing and v0 * v1 < 0.0:
        _advance(s, p, apex * step)
        _turn(s, p)
    elif landing <= 1.0:
        _advance(s, p, landing * step)
        _land(s, p, min(s.speed_mps, 0.0))
    elif turned:
        _move_to(s, 1.0, h1, 0.0, y1, yv1)
        _turn(s, p)
    else:
        _move_to(s, 1.0, h1, v1, y1, yv1)


@njit()
def _advance(s: Any, p: Any, step_s: float) -> None:
    """Move to an event located inside the step; a step that ends the interval ends it exactly."""
    h, v, y, yv = _step(s, p, step_s)
    u = s.u + step_s / s.dt_s
    _move_to(s, min(u, 1.0), h, v, y, yv)


@njit()
def _turn(s: Any, p: Any) -> None:
    """At a standstill in mid-air under friction: hang on the rod, or slide on in the direction of the pull."""
    s.speed_mps = 0.0
    # a ball that turns below a nanometre never came off
    if s.height_m < 1e-9:
        _land(s, p, 0.0)
        return
    s.state = HANGING
    if hang_margin(s, p, s.u, s.mode_m, s.mode_mps) > 0.0:
        _slide(s, p)


@njit()
def _slide(s: Any, p: Any) -> None:
    """Start to slide from a hang."""
    s.state, s.direction = FLIGHT, 1
    s.direction = 1 if net(s, p, s.height_m, 0.0, s.u, s.mode_m, s.mode_mps) > 0.0 else -1


@njit()
def _stay(s: Any, p: Any) -> None:
    """Rest on the plate or hang on the rod until the end of the interval, or until the ball moves."""
    u = 2.0
    if _margin(s, p, 1.0) > 0.0:
        lo, u = s.u, 1.0
        for _ in range(60):
            mid = 0.5 * (lo + u)
            if _margin(s, p, mid) > 0.0:
                u = mid
            else:
                lo = mid
            if u - lo < 1e-12:
                break
    if p.has_mode != 0.0:
        _, _, s.mode_m, s.mode_mps = _step(s, p, (min(u, 1.0) - s.u) * s.dt_s)
    s.u = min(u, 1.0)
    if u <= 1.0:
        if s.state == CONTACT:
            _leave(s, p, 0.0)
        else:
            _slide(s, p)


@njit()
def _quietly(s: Any, p: Any) -> bool:
    """Carry a ball under weight and constant friction through a whole interval without events; False if it has any.

    The same arithmetic as the general path, for the great majority of intervals.
    """
    g = gravity(p)
    if s.state == CONTACT:
        return bool(-s.node1 <= g * (1.0 + p.coulomb_friction_mu_up))
    if s.state == HANGING or s.commanded_open == 0:
        return False
    mu = p.coulomb_friction_mu_up if s.direction > 0 else -p.coulomb_friction_mu_down
    a, dt, v = g * (1.0 + mu) + s.a0, s.dt_s, s.speed_mps
    v1 = v - dt * (a + 0.5 * s.a1 + _THIRD * s.a2 + 0.25 * s.a3)
    h1 = s.height_m + dt * (v - dt * (0.5 * a + _SIXTH * s.a1 + 0.5 * _SIXTH * s.a2 + 0.05 * s.a3))
    if h1 < 0.0 or (v < 0.0 and v1 > 0.0) or (p.has_friction != 0.0 and s.direction * v1 < 0.0):
        return False
    s.height_m, s.speed_mps = h1, v1
    return True


@njit()
def move_ball(s: Any, p: Any) -> None:
    """Carry ball and table mode from the start of the interval to its end."""
    if p.is_simple != 0.0 and _quietly(s, p):
        s.u = 1.0
        return
    s.u = 0.0
    for _ in range(400):
        if s.state == FLIGHT:
            _fly(s, p)
        else:
            _stay(s, p)
        if s.u >= 1.0:
            return
    # a chattering ball with more events than any motion has in one interval is put to rest
    s.state, s.height_m, s.speed_mps, s.u = CONTACT, 0.0, 0.0, 1.0
