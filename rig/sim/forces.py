"""What acts on the plate and on the ball, in SI, at one place within the interval between two samples.

The rule kept here: these functions only evaluate; nothing moves. Heights and speeds are those of the ball
relative to the plate, up positive; friction acts against the relative speed, drag against the absolute one.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit


G_MPS2 = 9.80665
"""Standard gravity: the unit of every ``_g`` parameter."""


@njit(cache=True, inline="always")
def gravity(p: Any) -> float:
    """Local gravity, m/s^2."""
    return G_MPS2 * (1.0 + p.local_gravity_relative)


@njit(cache=True)
def plate_acceleration(s: Any, p: Any, u: float, y: float, yv: float, touching: bool) -> tuple[float, float]:
    """Acceleration of the plate and of its slow mode, m/s^2.

    With ``r`` the ball's mass over the table's, the load ``m (g + a)`` in contact gives ``a = a_d / (1 + r)``, and
    ``a_d + r g`` in flight, because the suspension carries the mean weight. The slow mode is loaded likewise.
    """
    a = s.a0 + u * (s.a1 + u * (s.a2 + u * s.a3))
    r = p.mass_loading_mass_ratio
    if r > 0.0:
        a = a / (1.0 + r) if touching else a + r * gravity(p)
    if p.has_mode == 0.0:
        return a, 0.0
    w = 2.0 * math.pi * p.table_resonance_frequency_hz
    share = p.table_resonance_mass_ratio
    pull = -w * w * y - 2.0 * p.table_resonance_damping * w * yv
    ydd = (pull - share * a) / (1.0 + share) if touching else pull + share * gravity(p)
    return a + ydd, ydd


@njit(cache=True)
def friction(s: Any, p: Any, h: float, v: float, t: float, direction: int) -> float:
    """Friction over local weight, >= 0: at rest (``v`` = 0) the largest that can be held."""
    mu = p.coulomb_friction_mu_up if direction > 0 else p.coulomb_friction_mu_down
    if direction == 0:
        mu = max(p.coulomb_friction_mu_up, p.coulomb_friction_mu_down)
    return mu


@njit(cache=True)
def other_forces(s: Any, p: Any, h: float, v: float, u: float, yv: float) -> float:
    """Sum of the smooth forces on the ball in flight beside weight and friction, m/s^2."""
    return 0.0


@njit(cache=True)
def pull_free(s: Any, p: Any, h: float, v: float, u: float, y: float, yv: float, touching: bool) -> float:
    """Relative acceleration of the ball before friction, m/s^2."""
    a, _ = plate_acceleration(s, p, u, y, yv, touching)
    free = -(gravity(p) + a)
    if p.has_force != 0.0:
        free += other_forces(s, p, h, v, u, yv)
    return free


@njit(cache=True)
def net(s: Any, p: Any, h: float, v: float, u: float, y: float, yv: float) -> float:
    """Relative acceleration in flight, friction against the current direction included, m/s^2."""
    free = pull_free(s, p, h, v, u, y, yv, False)
    if p.has_friction != 0.0:
        free -= s.direction * gravity(p) * friction(s, p, h, v, s.t_s + u * s.dt_s, s.direction)
    return free


@njit(cache=True)
def release_margin(s: Any, p: Any, u: float, y: float, yv: float) -> float:
    """Upward relative pull in excess of what holds the ball on the plate, m/s^2: it leaves when this is positive."""
    t = s.t_s + u * s.dt_s
    held = p.adhesion_pull_g * G_MPS2
    if p.has_friction != 0.0:
        held += gravity(p) * friction(s, p, 0.0, 0.0, t, 1)
    if p.has_hold != 0.0 and t < s.hold_until_s:
        held += 1e6
    return pull_free(s, p, 0.0, 0.0, u, y, yv, True) - held


@njit(cache=True)
def hang_margin(s: Any, p: Any, u: float, y: float, yv: float) -> float:
    """Pull in excess of what friction can hold in mid-air, m/s^2: the ball starts to slide when this is positive."""
    free = pull_free(s, p, s.height_m, 0.0, u, y, yv, True)
    t = s.t_s + u * s.dt_s
    return abs(free) - gravity(p) * friction(s, p, s.height_m, 0.0, t, 1 if free > 0.0 else -1)


@njit(cache=True)
def rebound(s: Any, p: Any, impact_mps: float, t: float) -> float:
    """Coefficient of restitution for this impact, 0 to 0.99."""
    e = p.restitution_e0 - p.restitution_e1_s_per_m * impact_mps
    return min(max(e, 0.0), 0.99)


