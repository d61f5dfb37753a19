"""A rig from its parts: amplifier, coil, table on a suspension, stiff and damped contact, block on a rod.

Nothing here is an effect with a size. Newton's second law moves the table and the ball, Kirchhoff's the coil; what the
closed loop calls a table's resonance, friction or restitution follows from masses, springs and dashpots. It shares no
formula with the model, nor with `rig.sim` and `benchmarks.plants.other_plant`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter

from benchmarks.plants.command import G, commands, level_at
from kernels import njit
from kernels.arrays import Floats

BALL_KG = 0.2492
STEPS_PER_SAMPLE = 250  # 0.2 us at 20 kHz: the contact's own frequency is 5 kHz or more
COIL = (30.0, 2.0, 3e-4)  # force over current, N/A; ohm; henry
FADE_CYCLES = 2
FLOOR_DAMPING = 0.05


@dataclass(frozen=True)
class Shaker:
    """Parts of the rig and what it is asked to do.

    Attributes
    ----------
    table_kg, suspension_hz, damping
        Moving mass, and the table's own frequency and damping ratio without the ball (the coil's apart).
    floor_kg, floor_hz
        What the shaker stands on, with a damping ratio of .05; a level in volts is set as if it stood still.
    voltage_driven
        The amplifier gives volts, and the coil's motion brakes it; else it gives current.
    level_set_bare
        The operator has set the drive's level before the ball was on the table; else with the ball at rest on it.
    contact_n_per_m, contact_damping
        Spring of the contact, and damping ratio of the ball on it: the more, the less it bounces.
    sliding_friction
        Of the rod, over the ball's weight; it holds the ball as well.
    oil_per_s
        Force of the rod over relative speed and the ball's mass.
    converter_hz
        Corner of the accelerometer's second-order anti-aliasing filter.
    """

    table_kg: float = 1e5
    suspension_hz: float = 8.0
    damping: float = 0.7
    floor_kg: float = 1e15
    floor_hz: float = 12.0
    voltage_driven: bool = False
    level_set_bare: bool = False
    contact_n_per_m: float = 1e9
    contact_damping: float = 20.0
    sliding_friction: float = 0.0
    oil_per_s: float = 0.0
    c: int = 1
    frequency_hz: float = 25.37
    gammas: tuple[float, ...] = ()
    cycles: int = 20
    rate_hz: float = 20000.0
    converter_hz: float = 6000.0
    accelerometer_noise_g: float = 0.01
    contact_noise_v: float = 0.01
    seed: int = 0

    def parts(self) -> tuple[float, ...]:
        """Of table and floor mass, spring, dashpot; of the contact spring, dashpot; friction, N; oil, N s/m."""
        floor = 2.0 * math.pi * self.floor_hz
        own = 2.0 * math.pi * self.suspension_hz
        dashpot = 2.0 * self.contact_damping * math.sqrt(self.contact_n_per_m * BALL_KG)
        return (
            self.table_kg, self.table_kg * own**2, 2.0 * self.damping * self.table_kg * own,
            self.floor_kg, self.floor_kg * floor**2, 2.0 * FLOOR_DAMPING * self.floor_kg * floor,
            self.contact_n_per_m, dashpot, self.sliding_friction * BALL_KG * G, self.oil_per_s * BALL_KG,
        )  # fmt: skip

    def drive(self) -> Floats:
        """Amplitude and phase of force (N) or volts of each tone at gamma 1, shape (2, 2), as the operator set them."""
        mass, spring, dashpot, floor, floor_spring, floor_dashpot, *_ = self.parts()
        force_per_ampere, ohm, henry = COIL
        out = np.empty((2, 2))
        for i, multiple in enumerate((1, self.c)):
            s = 2j * math.pi * self.frequency_hz * multiple
            held = spring + dashpot * s
            on_floor = held / (floor * s * s + floor_dashpot * s + floor_spring)
            asked = (mass + BALL_KG * (not self.level_set_bare)) * s * s * (1.0 + on_floor) + held
            if self.voltage_driven:
                asked = asked * (ohm + henry * s) / force_per_ampere + force_per_ampere * s
            asked *= G / (2.0 * math.pi * self.frequency_hz) ** 2
            out[i] = abs(asked), np.angle(asked)
        return out


@njit()
def _march(parts, coil, voltage_driven, drive, gammas, step_s, w, c, dt, plate, touching):
    """March table, ball and coil; fill the mean acceleration and the part in contact of the time before each sample."""
    table, spring, dashpot, floor, floor_spring, floor_dashpot, contact, contact_dashpot, friction, oil = parts
    force_per_ampere, ohm, henry = coil
    fade_s, weight = FADE_CYCLES * 2.0 * math.pi / w, BALL_KG * G
    below = -weight / floor_spring  # the floor; x: the table, y: the ball, all from where they rest without the ball
    x = below - weight / spring
    y = x - weight / contact
    v = u = ampere = sinking = 0.0
    together = BALL_KG * table / (BALL_KG + table)
    for k in range(1, plate.size):
        total, contacts = 0.0, 0
        for j in range(STEPS_PER_SAMPLE):
            t = ((k - 1) * STEPS_PER_SAMPLE + j) * dt
            asked = drive[0, 0] * math.sin(w * t + drive[0, 1]) + drive[1, 0] * math.sin(c * w * t + drive[1, 1])
            asked *= level_at(gammas, step_s, fade_s, t)[0]
            if voltage_driven:
                ampere += dt * (asked - ohm * ampere - force_per_ampere * (v - sinking)) / henry
                asked = force_per_ampere * ampere
            push = max(contact * (x - y) + contact_dashpot * (v - u), 0.0) if x > y else 0.0
            held = spring * (x - below) + dashpot * (v - sinking) - asked  # between table and floor, coil and all
            on_table, on_ball = -held - push, push - weight
            sticking = together * ((u - v) / dt + on_ball / BALL_KG - on_table / table)  # would leave no relative speed
            rod = min(max(sticking, -friction), friction) + oil * (u - v)
            a = (on_table + rod) / table
            v += dt * a
            sinking += dt * (held - floor_spring * below - floor_dashpot * sinking) / floor
            below += dt * sinking
            u += dt * (on_ball - rod) / BALL_KG
            x += dt * v
            y += dt * u
            total += a
            contacts += push > 0.0
        plate[k], touching[k] = total / STEPS_PER_SAMPLE, contacts / STEPS_PER_SAMPLE


def simulate(rig: Shaker) -> dict[str, Floats]:
    """What the rig's owner records.

    Returns
    -------
    dict of float64 arrays
        ``time_s, continuity_v, accelerometer_v, drive_v`` (n,).
    """
    rng = np.random.default_rng(rig.seed)
    gammas, w = np.array(rig.gammas), 2.0 * math.pi * rig.frequency_hz
    step_s = rig.cycles / rig.frequency_hz
    n = int(len(gammas) * step_s * rig.rate_hz)
    plate, touching = np.zeros(n), np.ones(n)
    dt = 1.0 / (rig.rate_hz * STEPS_PER_SAMPLE)
    _march(rig.parts(), COIL, rig.voltage_driven, rig.drive(), gammas, step_s, w, float(rig.c), dt, plate, touching)
    time_s = np.arange(n) / rig.rate_hz
    asked = commands(gammas, step_s, FADE_CYCLES / rig.frequency_hz, w, float(rig.c), time_s)
    b, a = butter(2, rig.converter_hz / (rig.rate_hz / 2.0))
    felt_g = lfilter(b, a, plate) / G + 1.0 + rig.accelerometer_noise_g * rng.standard_normal(n)
    volts = {
        "continuity_v": 5.0 * (1.0 - touching) + rig.contact_noise_v * rng.standard_normal(n),
        "accelerometer_v": 0.1 * felt_g,
        "drive_v": asked / (1.6 * G) + 0.0005 * rng.standard_normal(n),
    }
    step_v = 20.0 / 2**16
    return {"time_s": time_s, **{name: np.round(v / step_v) * step_v for name, v in volts.items()}}
