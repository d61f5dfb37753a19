"""Every effect the simulated rig can hide: names, parameters, units, and how strong is strong.

The rule kept here: one table. The layout of the compiled plant's parameter record, the strictness of scenario
files, the sealed draws and the documentation all come from it. A parameter at its neutral value does nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes
    ----------
    name : str
        Name within the effect; carries the unit where it has one.
    strong : tuple of float
        Range drawn from when the effect is strong.
    scales : bool
        True where strength multiplies this number; False where it only shapes the effect.
    neutral : float
        The value at which the effect is absent (shape parameters: any harmless value).
    low, high : float
        Limits accepted in a scenario file.
    """

    name: str
    strong: tuple[float, float]
    scales: bool = True
    neutral: float = 0.0
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class EffectEntry:
    """One effect that can be hidden.

    Attributes
    ----------
    name : str
        Name used in scenario files.
    parameters : tuple of Parameter
    in_words : str
        What it does.
    named : bool
        True where the effect has an agreed name among the candidates; False for effects beyond them.
    term : str
        What it changes: force, threshold, restitution, plate or sensor.
    covariate : str
        Where the effect is a smooth term of one covariate: which; else empty.
    """

    name: str
    parameters: tuple[Parameter, ...]
    in_words: str
    named: bool = True
    term: str = "force"
    covariate: str = ""


def _size(name: str, lo: float, hi: float, low: float = -np.inf, high: float = np.inf) -> Parameter:
    return Parameter(name, (lo, hi), True, 0.0, low, high)


def _shape(name: str, lo: float, hi: float, neutral: float = 1.0, low: float = 1e-12, high: float = np.inf) -> Parameter:
    return Parameter(name, (lo, hi), False, neutral, low, high)


def _beyond(name: str, parameters: tuple[Parameter, ...], words: str, term: str, covariate: str = "") -> EffectEntry:
    return EffectEntry(name, parameters, words, False, term, covariate)


NAMED: tuple[EffectEntry, ...] = (
    EffectEntry(
        "coulomb_friction",
        (_size("mu_up", 0.05, 0.3, 0.0, 2.0), _size("mu_down", 0.05, 0.3, 0.0, 2.0)),
        "dry friction on the rod, in units of the local weight, against motion relative to the plate",
    ),
    EffectEntry(
        "stribeck_friction",
        (_size("mu_static", 0.1, 0.3, 0.0, 2.0), _size("mu_kinetic", 0.02, 0.08, 0.0, 2.0), _shape("speed_mps", 0.02, 0.2)),
        "dry friction falling from its static to its kinetic value as speed grows",
    ),
    EffectEntry("viscous_damping", (_size("rate_per_s", 1.0, 6.0, 0.0, 200.0),), "force against relative velocity"),
    EffectEntry(
        "quadratic_drag", (_size("coefficient_per_m", 0.5, 3.0, 0.0, 100.0),), "force against absolute velocity squared"
    ),
    EffectEntry(
        "restitution",
        (_size("e0", 0.1, 0.55, 0.0, 0.99), _size("e1_s_per_m", 0.0, 0.15, -2.0, 2.0)),
        "rebound e = e0 - e1 v, v the impact speed relative to the plate",
        term="restitution",
    ),
    EffectEntry(
        "adhesion", (_size("pull_g", 0.05, 0.3, 0.0, 5.0),), "extra pull in contact that is gone once apart", term="threshold"
    ),
    EffectEntry(
        "position_force",
        (_size("stiffness_per_s2", 50.0, 300.0, -1e4, 1e4), _size("magnet_g", 0.0, 0.1, -2.0, 2.0), _shape("range_m", 0.001, 0.005)),
        "spring towards the plate, and a magnet whose pull decays with height",
    ),
    EffectEntry("local_gravity", (_size("relative", 0.02, 0.08, -0.5, 0.5),), "gravity differs from the standard one"),
    EffectEntry(
        "table_resonance",
        (_shape("frequency_hz", 4.0, 12.0, 5.0), _shape("damping", 0.02, 0.1, 0.05), _size("mass_ratio", 0.01, 0.04, 0.0, 1.0)),
        "a slow mode of the whole shaker, driven by the impacts and the ball's weight",
        term="plate",
    ),
    EffectEntry("drive_gain", (_size("relative", 0.03, 0.12, -0.9, 5.0),), "the amplifier's gain is off", term="plate"),
    EffectEntry(
        "gain_compression", (_size("per_v2", 0.05, 0.2, 0.0, 10.0),), "gain falls with the drive's mean square", term="plate"
    ),
    EffectEntry("phase_lag", (_size("time_constant_s", 2e-4, 1e-3, 0.0, 0.02),), "first-order lag of the shaker", term="plate"),
    EffectEntry(
        "harmonic_distortion",
        (_size("second_per_v", 0.01, 0.04, -1.0, 1.0), _size("third_per_v2", 0.01, 0.04, -1.0, 1.0)),
        "the amplifier bends: second and third harmonics",
        term="plate",
    ),
    EffectEntry(
        "mains_hum",
        (_size("amplitude_g", 0.03, 0.12, 0.0, 5.0), _shape("frequency_hz", 49.95, 50.05, 50.0), _shape("phase_rad", 0.0, 6.28, 0.0, 0.0)),
        "motion of the plate at the mains frequency",
        term="plate",
    ),
    EffectEntry(
        "amplitude_modulation",
        (_size("depth", 0.02, 0.08, 0.0, 0.9), _shape("frequency_hz", 0.3, 2.0)),
        "the drive's amplitude breathes",
        term="plate",
    ),
    EffectEntry("accelerometer_gain", (_size("relative", 0.03, 0.1, -0.9, 5.0),), "the accelerometer's scale is off", term="sensor"),
    EffectEntry("accelerometer_offset", (_size("offset_g", 0.05, 0.3, -20.0, 20.0),), "the accelerometer's zero is off", term="sensor"),
    EffectEntry("contact_latency", (_size("delay_s", 2e-4, 8e-4, 0.0, 0.02),), "the contact circuit reports both edges late", term="sensor"),
    EffectEntry("contact_gap", (_size("gap_m", 1e-7, 5e-7, 0.0, 1e-3),), "the circuit opens only at this height", term="sensor"),
    EffectEntry("clock_error", (_size("relative", 2e-3, 1e-2, -0.1, 0.1),), "the card's true rate differs from its nominal one", term="sensor"),
    EffectEntry("mass_loading", (_size("mass_ratio", 0.02, 0.08, 0.0, 1.0),), "the ball in contact loads the table", term="plate"),
    EffectEntry("contact_closure", (_size("duration_s", 2e-4, 1e-3, 0.0, 0.01),), "an impact keeps the circuit closed for a while", term="sensor"),
)

BEYOND: tuple[EffectEntry, ...] = (
    _beyond("height_friction", (_size("mu_per_m", 20.0, 60.0, 0.0, 1e3),), "friction grows with height", "force", "height"),
    _beyond(
        "velocity_friction",
        (_size("mu", 0.1, 0.3, 0.0, 2.0), _shape("centre_mps", 0.1, 0.25), _shape("width_mps", 0.05, 0.1)),
        "friction has a hump at one speed", "force", "velocity",
    ),
    _beyond("latch_force", (_size("pull_g", 0.05, 0.2, -2.0, 2.0), _shape("height_m", 0.001, 0.003), _shape("width_m", 2e-4, 1e-3)),
            "a magnet on the rod pulls back above a height", "force", "height"),
    _beyond("level_friction", (_size("mu_per_v2", 0.1, 0.4, 0.0, 10.0),), "friction grows with the level of the drive", "force", "gamma"),
    _beyond("warming_force", (_size("pull_g", 0.05, 0.2, -2.0, 2.0), _shape("time_constant_s", 5.0, 20.0)),
            "a downward pull that builds up as the rig warms, and saturates", "force", "time in run"),
    _beyond("charge_force", (_size("pull_g", 0.05, 0.2, -2.0, 2.0), _shape("flight_s", 0.02, 0.05)),
            "a pull set by how long the previous flight rubbed the rod", "force", "previous flight"),
    _beyond("ageing_threshold", (_size("pull_g", 0.05, 0.2, 0.0, 5.0), _shape("time_constant_s", 0.002, 0.02)),
            "the stick threshold grows with the time spent in contact", "threshold", "dwell time"),
    _beyond("impact_restitution", (_size("e", 0.1, 0.4, 0.0, 0.95), _shape("centre_mps", 0.2, 0.4), _shape("width_mps", 0.05, 0.15)),
            "rebound only around one impact speed", "restitution", "impact speed"),
    _beyond("memory_restitution", (_size("e", 0.1, 0.4, 0.0, 0.95), _shape("flight_s", 0.02, 0.05)),
            "rebound grows with the previous flight's length", "restitution", "previous flight"),
    _beyond("acceleration_restitution", (_size("e", 0.1, 0.4, 0.0, 0.95), _shape("scale_g", 1.0, 3.0)),
            "rebound grows with the plate's acceleration at impact", "restitution", "plate acceleration"),
    _beyond("recovery_friction", (_size("mu", 0.1, 0.4, 0.0, 2.0), _shape("time_constant_s", 0.005, 0.02)),
            "friction high just after an impact, then decaying", "force", "time since impact"),
    _beyond("air_cushion", (_size("rate_per_s", 20.0, 100.0, 0.0, 5e3), _shape("height_m", 5e-5, 3e-4)),
            "squeezed air resists motion near the plate", "force"),
    _beyond("oil_film", (_size("pull_g", 0.3, 1.5, 0.0, 20.0), _shape("height_m", 5e-5, 2e-4), _shape("speed_mps", 0.01, 0.05)),
            "a film holds the ball back as it leaves, the more the faster", "force"),
    _beyond("rod_rocking", (_size("mu", 0.2, 0.6, 0.0, 3.0), _shape("frequency_hz", 30.0, 90.0, 50.0), _shape("decay_s", 0.02, 0.08)),
            "impacts set the block rocking on the rod, which modulates friction until it dies out", "force"),
    _beyond("alternate_seat", (_size("mu", 0.05, 0.25, 0.0, 2.0),), "two seats taken in turn: friction after every other impact only", "force"),
    _beyond("rod_angle_friction", (_size("mu", 0.1, 0.3, 0.0, 2.0), _shape("period_s", 1.0, 5.0)),
            "the block turns slowly about the rod, which is rough on one side", "force"),
    _beyond("impact_hold", (_size("hold_s_per_mps", 0.01, 0.05, 0.0, 1.0),), "a soft table holds the ball for a time set by the impact speed", "threshold"),
    _beyond("worn_bearing", (_size("mu", 0.05, 0.25, 0.0, 2.0), _shape("since_s", 5.0, 15.0)), "friction appears at one moment of the run", "force"),
    _beyond("scattered_restitution", (_size("e", 0.1, 0.4, 0.0, 0.95),), "rebound drawn anew at each impact, from nothing to this", "restitution"),
)

EFFECTS: dict[str, EffectEntry] = {entry.name: entry for entry in (*NAMED, *BEYOND)}
"""All effects by name (`parameter_drift` is a modifier of these, see `rig.sim.scenario`)."""

RIG_DEFAULTS: dict[str, float] = {
    "g_per_volt": 2.0,  # plate acceleration per drive volt, in standard g
    "clip_v": 10.0,  # amplifier limit
    "adc_range_v": 10.0,
    "adc_bits": 16.0,
    "accelerometer_v_per_g": 0.1,
    "accelerometer_noise_g": 0.03,
    "accelerometer_reads_gravity": 0.0,
    "ring_g_s_per_m": 10.0,  # ringing after an impact, per m/s of impact speed
    "ring_frequency_hz": 1700.0,
    "ring_decay_s": 0.001,
    "open_v": 5.0,
    "closed_v": 0.0,
    "rc_open_s": 2e-5,
    "rc_close_s": 2e-5,
    "continuity_noise_v": 0.002,
    "bounce_s": 0.0,  # mechanical chatter of the contact after a landing, at most this long
    "drive_noise_v": 0.0003,
    "shaker_frequency_hz": 0.0,  # 0: the shaker's own resonance is equalised away
    "shaker_damping": 0.5,
}
"""The rig around the ball: what a scenario's ``[rig]`` table may set."""


def parameter_dtype() -> np.dtype[np.void]:
    """Layout of the parameter record handed to the compiled plant: rig numbers, then ``effect_parameter`` fields."""
    fields = [(name, "f8") for name in RIG_DEFAULTS]
    fields += [(f"{e.name}_{p.name}", "f8") for e in EFFECTS.values() for p in e.parameters]
    fields += [(f"has_{name}", "f8") for name in ("friction", "force", "hold", "mode")]
    return np.dtype(fields)
