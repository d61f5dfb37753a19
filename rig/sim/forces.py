"""Forces on the plate and on the ball, in SI, at one place within the interval between two samples.

These functions only evaluate; nothing moves. Heights and speeds are those of the ball
relative to the plate, up positive; friction acts against the relative speed, drag against the absolute one.
"""

from __future__ import annotations

import math
from typing import Any

from kernels import njit

G_MPS2 = 9.80665
"""Standard gravity: the unit of every ``_g`` parameter."""


@njit(inline="always")
def gravity(p: Any) -> float:
    """Local gravity, m/s^2."""
    return float(G_MPS2 * (1.0 + p.local_gravity_relative))


@njit()
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


@njit()
def _bell(x: float, centre: float, width: float) -> float:
    return math.exp(-(((x - centre) / width) ** 2))


@njit()
def _unusual_friction(s: Any, p: Any, h: float, v: float, t: float) -> float:
    """Friction that depends on more than the direction, over local weight."""
    mu = p.height_friction_mu_per_m * h + p.level_friction_mu_per_v2 * s.mean_square_v2
    if p.stribeck_friction_mu_static > 0.0:
        drop = p.stribeck_friction_mu_static - p.stribeck_friction_mu_kinetic
        mu += p.stribeck_friction_mu_kinetic + drop * math.exp(-abs(v) / p.stribeck_friction_speed_mps)
    if p.velocity_friction_mu > 0.0:
        mu += p.velocity_friction_mu * _bell(abs(v), p.velocity_friction_centre_mps, p.velocity_friction_width_mps)
    if p.recovery_friction_mu > 0.0:
        mu += p.recovery_friction_mu * math.exp(-(t - s.landed_s) / p.recovery_friction_time_constant_s)
    if p.rod_rocking_mu > 0.0:
        since = t - s.landed_s
        swing = 0.5 + 0.5 * math.cos(2.0 * math.pi * p.rod_rocking_frequency_hz * since)
        mu += p.rod_rocking_mu * s.rocking * math.exp(-since / p.rod_rocking_decay_s) * swing
    if p.rod_angle_friction_mu > 0.0:
        mu += p.rod_angle_friction_mu * (0.5 + 0.5 * math.cos(2.0 * math.pi * t / p.rod_angle_friction_period_s))
    mu += p.alternate_seat_mu * s.parity
    if t > p.worn_bearing_since_s:
        mu += p.worn_bearing_mu
    return float(max(mu, 0.0))


@njit()
def friction(s: Any, p: Any, h: float, v: float, t: float, direction: int) -> float:
    """Friction over local weight, >= 0, against sliding in ``direction``; at ``v`` = 0 the most that can be held."""
    mu = p.coulomb_friction_mu_up if direction > 0 else p.coulomb_friction_mu_down
    if p.has_unusual_friction != 0.0:
        mu += _unusual_friction(s, p, h, v, t)
    return float(mu)


@njit()
def _other_forces(s: Any, p: Any, h: float, v: float, u: float, yv: float) -> float:
    """Sum of the forces on the ball other than weight and friction, over its mass, m/s^2."""
    force = -p.viscous_damping_rate_per_s * v - p.position_force_spring_per_s2 * h
    if p.quadratic_drag_k_per_m != 0.0:
        gained = u * (s.a0 + u * (s.a1 / 2.0 + u * (s.a2 / 3.0 + u * s.a3 / 4.0)))
        absolute = v + s.plate_mps + s.dt_s * gained + yv
        force -= p.quadratic_drag_k_per_m * abs(absolute) * absolute
    pull = p.position_force_magnet_g * math.exp(-h / p.position_force_range_m)
    if p.latch_force_pull_g != 0.0:
        pull += p.latch_force_pull_g * 0.5 * (1.0 + math.tanh((h - p.latch_force_height_m) / p.latch_force_width_m))
    if p.warming_force_pull_g != 0.0:
        t = s.t_s + u * s.dt_s
        pull += p.warming_force_pull_g * (1.0 - math.exp(-t / p.warming_force_time_constant_s))
    if p.charge_force_pull_g != 0.0:
        pull += p.charge_force_pull_g * (1.0 - math.exp(-s.flight_s / p.charge_force_flight_s))
    if p.air_cushion_rate_per_s != 0.0:
        force -= p.air_cushion_rate_per_s * v / (1.0 + max(h, 0.0) / p.air_cushion_height_m) ** 3
    if p.oil_film_pull_g != 0.0 and v > 0.0:
        pull += p.oil_film_pull_g * math.exp(-h / p.oil_film_height_m) * v / (v + p.oil_film_speed_mps)
    return float(force - G_MPS2 * pull)


@njit()
def pull_free(s: Any, p: Any, h: float, v: float, u: float, yv: float, a: float) -> float:
    """Relative acceleration of the ball before friction over a plate of acceleration ``a``, m/s^2."""
    free = -(gravity(p) + a)
    if p.has_force != 0.0:
        free += _other_forces(s, p, h, v, u, yv)
    return float(free)


@njit()
def net(s: Any, p: Any, h: float, v: float, u: float, y: float, yv: float) -> float:
    """Relative acceleration in flight, friction against the current direction included, m/s^2."""
    free = pull_free(s, p, h, v, u, yv, plate_acceleration(s, p, u, y, yv, False)[0])
    if p.has_friction != 0.0:
        free -= s.direction * gravity(p) * friction(s, p, h, v, s.t_s + u * s.dt_s, s.direction)
    return free


@njit()
def release_margin(s: Any, p: Any, u: float, y: float, yv: float) -> float:
    """Upward relative pull in excess of what holds the ball on the plate, m/s^2: it leaves when this is positive."""
    t = s.t_s + u * s.dt_s
    held = p.adhesion_pull_g * G_MPS2
    if p.ageing_threshold_pull_g != 0.0:
        rested = 1.0 - math.exp(-(t - s.contact_since_s) / p.ageing_threshold_time_constant_s)
        held += G_MPS2 * p.ageing_threshold_pull_g * rested
    if p.has_friction != 0.0:
        held += gravity(p) * friction(s, p, 0.0, 0.0, t, 1)
    if p.has_hold != 0.0 and t < s.hold_until_s:
        held += 1e6
    return float(pull_free(s, p, 0.0, 0.0, u, yv, plate_acceleration(s, p, u, y, yv, True)[0]) - held)


@njit()
def hang_margin(s: Any, p: Any, u: float, y: float, yv: float) -> float:
    """Pull in excess of what friction can hold in mid-air, m/s^2: the ball starts to slide when this is positive."""
    free = pull_free(s, p, s.height_m, 0.0, u, yv, plate_acceleration(s, p, u, y, yv, True)[0])
    t = s.t_s + u * s.dt_s
    return abs(free) - gravity(p) * friction(s, p, s.height_m, 0.0, t, 1 if free > 0.0 else -1)


@njit()
def rebound(s: Any, p: Any, impact_mps: float, chance: float) -> float:
    """Coefficient of restitution for this impact, 0 to 0.99; ``chance`` is uniform in [0, 1)."""
    e = p.restitution_e0 - p.restitution_e1_s_per_m * impact_mps + p.scattered_restitution_e * chance
    if p.restitution_scatter_sd > 0.0:
        # two-sided exponential: above its mean as often as below
        tail = -math.log(max(1.0 - 2.0 * abs(chance - 0.5), 1e-12)) * p.restitution_scatter_sd / math.sqrt(2.0)
        e += tail if chance > 0.5 else -tail
    if p.impact_restitution_e > 0.0:
        e += p.impact_restitution_e * _bell(impact_mps, p.impact_restitution_centre_mps, p.impact_restitution_width_mps)
    if p.memory_restitution_e > 0.0:
        e += p.memory_restitution_e * (1.0 - math.exp(-s.flight_s / p.memory_restitution_flight_s))
    if p.acceleration_restitution_e > 0.0:
        a = plate_acceleration(s, p, s.u, s.mode_m, s.mode_mps, False)[0] / G_MPS2
        e += p.acceleration_restitution_e * 0.5 * (1.0 + math.tanh(a / p.acceleration_restitution_scale_g))
    return float(min(max(e, 0.0), 0.99))
