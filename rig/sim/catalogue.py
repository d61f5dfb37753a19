"""Every effect the simulated rig can hide: names, parameters, units, and how strong is strong.

One table. The layout of the compiled plant's parameter record, the strictness of scenario
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
    unit_us : float
        Microseconds by which one hundredth of the middle of the strong range typically moves the next landing or
        take-off (or what is as easily seen in another channel); strengths are drawn in these units.
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
    unit_us: float
    named: bool = True
    term: str = "force"
    covariate: str = ""


def _size(name: str, lo: float, hi: float, low: float = -np.inf, high: float = np.inf) -> Parameter:
    return Parameter(name, (lo, hi), True, 0.0, low, high)


def _shape(name: str, lo: float, hi: float, neutral: float, low: float = 1e-12) -> Parameter:
    return Parameter(name, (lo, hi), False, neutral, low, np.inf)


def _named(name: str, unit_us: float, term: str, words: str, *parameters: Parameter) -> EffectEntry:
    return EffectEntry(name, parameters, words, unit_us, True, term)


def _beyond(name: str, unit_us: float, term: str, covariate: str, words: str, *parameters: Parameter) -> EffectEntry:
    return EffectEntry(name, parameters, words, unit_us, False, term, covariate)


NAMED: tuple[EffectEntry, ...] = (
    _named(
        "coulomb_friction",
        37.0,
        "force",
        "dry friction on the rod, in units of the local weight, against motion relative to the plate",
        _size("mu_up", 0.05, 0.3, 0.0, 2.0),
        _size("mu_down", 0.05, 0.3, 0.0, 2.0),
    ),
    _named(
        "stribeck_friction",
        29.0,
        "force",
        "dry friction falling from its static to its kinetic value as speed grows",
        _size("mu_static", 0.1, 0.3, 0.0, 2.0),
        _size("mu_kinetic", 0.02, 0.08, 0.0, 2.0),
        _shape("speed_mps", 0.02, 0.2, 1.0),
    ),
    _named(
        "viscous_damping", 5.9, "force", "force against relative velocity", _size("rate_per_s", 1.0, 6.0, 0.0, 200.0)
    ),
    _named(
        "quadratic_drag",
        2.5,
        "force",
        "force against absolute velocity squared",
        _size("k_per_m", 5.0, 30.0, 0.0, 200.0),
    ),
    _named(
        "restitution",
        20.0,
        "restitution",
        "rebound e = e0 - e1 v, v the impact speed relative to the plate",
        _size("e0", 0.1, 0.55, 0.0, 0.99),
        _size("e1_s_per_m", 0.0, 0.15, -2.0, 2.0),
    ),
    _named(
        "adhesion",
        5.8,
        "threshold",
        "extra pull in contact that is gone once they part",
        _size("pull_g", 0.05, 0.3, 0.0, 5.0),
    ),
    _named(
        "position_force",
        16.0,
        "force",
        "spring towards the plate, and a magnet whose pull decays with height",
        _size("spring_per_s2", 50.0, 300.0, -10000.0, 10000.0),
        _size("magnet_g", 0.0, 0.1, -2.0, 2.0),
        _shape("range_m", 0.001, 0.005, 1.0),
    ),
    _named(
        "local_gravity",
        14.6,
        "force",
        "gravity differs from the standard one",
        _size("relative", 0.02, 0.08, -0.5, 0.5),
    ),
    _named(
        "table_resonance",
        7.6,
        "plate",
        "a slow mode of the whole shaker, driven by the impacts and the ball's weight",
        _shape("frequency_hz", 4.0, 12.0, 5.0),
        _shape("damping", 0.02, 0.1, 0.05),
        _size("mass_ratio", 0.01, 0.04, 0.0, 1.0),
    ),
    _named("drive_gain", 22.0, "plate", "the amplifier's gain is off", _size("relative", 0.03, 0.12, -0.9, 5.0)),
    _named(
        "gain_compression",
        32.0,
        "plate",
        "gain falls with the drive's mean square",
        _size("per_v2", 0.05, 0.2, 0.0, 10.0),
    ),
    _named(
        "phase_lag", 8.8, "plate", "first-order lag of the shaker", _size("time_constant_s", 0.0002, 0.001, 0.0, 0.02)
    ),
    _named(
        "harmonic_distortion",
        8.0,
        "plate",
        "the amplifier bends: second and third harmonics",
        _size("second_per_v", 0.01, 0.04, -1.0, 1.0),
        _size("third_per_v2", 0.01, 0.04, -1.0, 1.0),
    ),
    _named(
        "mains_hum",
        3.0,
        "plate",
        "motion of the plate at the mains frequency",
        _size("amplitude_g", 0.03, 0.12, 0.0, 5.0),
        _shape("frequency_hz", 49.95, 50.05, 50.0),
        _shape("phase_rad", 0.0, 6.28, 0.0, 0.0),
    ),
    _named(
        "amplitude_modulation",
        10.0,
        "plate",
        "the drive's amplitude breathes",
        _size("depth", 0.02, 0.08, 0.0, 0.9),
        _shape("frequency_hz", 0.3, 2.0, 1.0),
    ),
    _named(
        "accelerometer_gain",
        22.0,
        "sensor",
        "the accelerometer's scale is off",
        _size("relative", 0.03, 0.1, -0.9, 5.0),
    ),
    _named(
        "accelerometer_offset",
        35.0,
        "sensor",
        "the accelerometer's zero is off",
        _size("offset_g", 0.05, 0.3, -20.0, 20.0),
    ),
    _named(
        "contact_latency",
        5.0,
        "sensor",
        "the contact circuit reports both edges late",
        _size("delay_s", 0.0002, 0.0008, 0.0, 0.02),
    ),
    _named(
        "accelerometer_lag",
        5.0,
        "sensor",
        "low-pass of first order in the accelerometer",
        _size("time_constant_s", 0.0002, 0.0008, 0.0, 0.02),
    ),
    _named(
        "accelerometer_high_pass",
        5.0,
        "sensor",
        "high-pass of first order in the accelerometer's amplifier",
        _size("corner_hz", 0.5, 2.0, 0.0, 20.0),
    ),
    _named(
        "mains_pickup",
        3.0,
        "sensor",
        "the accelerometer's cable picks up the mains",
        _size("amplitude_g", 0.05, 0.15, 0.0, 5.0),
        _shape("frequency_hz", 49.95, 50.05, 50.0),
        _shape("phase_rad", 0.0, 6.28, 0.0, 0.0),
    ),
    _named(
        "contact_gap", 20.0, "sensor", "the circuit opens only at this height", _size("gap_m", 1e-07, 5e-07, 0.0, 0.001)
    ),
    _named(
        "clock_error",
        3.3,
        "sensor",
        "the card's true rate differs from its nominal one",
        _size("relative", 0.002, 0.01, -0.1, 0.1),
    ),
    _named(
        "mass_loading", 14.6, "plate", "the ball in contact loads the table", _size("mass_ratio", 0.02, 0.08, 0.0, 1.0)
    ),
    _named(
        "contact_closure",
        6.0,
        "sensor",
        "an impact keeps the circuit closed for a while",
        _size("duration_s", 0.0002, 0.001, 0.0, 0.01),
    ),
)

BEYOND: tuple[EffectEntry, ...] = (
    _beyond(
        "height_friction",
        4.6,
        "force",
        "height",
        "friction grows with height",
        _size("mu_per_m", 20.0, 60.0, 0.0, 1000.0),
    ),
    _beyond(
        "velocity_friction",
        13.0,
        "force",
        "velocity",
        "friction has a hump at one speed",
        _size("mu", 0.1, 0.3, 0.0, 2.0),
        _shape("centre_mps", 0.1, 0.25, 1.0),
        _shape("width_mps", 0.05, 0.1, 1.0),
    ),
    _beyond(
        "latch_force",
        5.0,
        "force",
        "height",
        "a magnet on the rod pulls back above a height",
        _size("pull_g", 0.05, 0.2, -2.0, 2.0),
        _shape("height_m", 0.001, 0.003, 1.0),
        _shape("width_m", 0.0002, 0.001, 1.0),
    ),
    _beyond(
        "level_friction",
        50.0,
        "force",
        "gamma",
        "friction grows with the level of the drive",
        _size("mu_per_v2", 0.1, 0.4, 0.0, 10.0),
    ),
    _beyond(
        "warming_force",
        21.0,
        "force",
        "time in run",
        "a downward pull that builds up as the rig warms, and saturates",
        _size("pull_g", 0.05, 0.2, -2.0, 2.0),
        _shape("time_constant_s", 5.0, 20.0, 1.0),
    ),
    _beyond(
        "charge_force",
        21.0,
        "force",
        "previous flight",
        "a pull set by how long the previous flight rubbed the rod",
        _size("pull_g", 0.05, 0.2, -2.0, 2.0),
        _shape("flight_s", 0.02, 0.05, 1.0),
    ),
    _beyond(
        "ageing_threshold",
        5.6,
        "threshold",
        "dwell time",
        "the stick threshold grows with the time spent in contact",
        _size("pull_g", 0.2, 0.8, 0.0, 5.0),
        _shape("time_constant_s", 0.002, 0.02, 1.0),
    ),
    _beyond(
        "impact_restitution",
        20.0,
        "restitution",
        "impact speed",
        "rebound only around one impact speed",
        _size("e", 0.1, 0.4, 0.0, 0.95),
        _shape("centre_mps", 0.2, 0.4, 1.0),
        _shape("width_mps", 0.05, 0.15, 1.0),
    ),
    _beyond(
        "memory_restitution",
        20.0,
        "restitution",
        "previous flight",
        "rebound grows with the previous flight's length",
        _size("e", 0.1, 0.4, 0.0, 0.95),
        _shape("flight_s", 0.02, 0.05, 1.0),
    ),
    _beyond(
        "acceleration_restitution",
        20.0,
        "restitution",
        "plate acceleration",
        "rebound grows with the plate's acceleration at impact",
        _size("e", 0.1, 0.4, 0.0, 0.95),
        _shape("scale_g", 1.0, 3.0, 1.0),
    ),
    _beyond(
        "recovery_friction",
        21.0,
        "force",
        "time since impact",
        "friction high just after an impact, then decaying",
        _size("mu", 0.1, 0.4, 0.0, 2.0),
        _shape("time_constant_s", 0.005, 0.02, 1.0),
    ),
    _beyond(
        "air_cushion",
        7.0,
        "force",
        "",
        "squeezed air resists motion near the plate",
        _size("rate_per_s", 20.0, 100.0, 0.0, 5000.0),
        _shape("height_m", 5e-05, 0.0003, 1.0),
    ),
    _beyond(
        "oil_film",
        21.0,
        "force",
        "",
        "a film holds the ball back as it leaves, the more the faster",
        _size("pull_g", 0.3, 1.5, 0.0, 20.0),
        _shape("height_m", 5e-05, 0.0002, 1.0),
        _shape("speed_mps", 0.01, 0.05, 1.0),
    ),
    _beyond(
        "rod_rocking",
        30.0,
        "force",
        "",
        "impacts set the block rocking on the rod, which modulates friction until it dies out",
        _size("mu", 0.2, 0.6, 0.0, 3.0),
        _shape("frequency_hz", 30.0, 90.0, 50.0),
        _shape("decay_s", 0.02, 0.08, 1.0),
    ),
    _beyond(
        "alternate_seat",
        7.0,
        "force",
        "",
        "two seats taken in turn: friction after every other impact only",
        _size("mu", 0.05, 0.25, 0.0, 2.0),
    ),
    _beyond(
        "rod_angle_friction",
        22.0,
        "force",
        "",
        "the block turns slowly about the rod, which is rough on one side",
        _size("mu", 0.1, 0.3, 0.0, 2.0),
        _shape("period_s", 1.0, 5.0, 1.0),
    ),
    _beyond(
        "impact_hold",
        60.0,
        "threshold",
        "",
        "a soft table holds the ball for a time set by the impact speed",
        _size("hold_s_per_mps", 0.01, 0.05, 0.0, 1.0),
    ),
    _beyond(
        "worn_bearing",
        30.0,
        "force",
        "",
        "friction appears at one moment of the run",
        _size("mu", 0.05, 0.25, 0.0, 2.0),
        _shape("since_s", 5.0, 15.0, 1.0),
    ),
    _beyond(
        "scattered_restitution",
        20.0,
        "restitution",
        "",
        "rebound drawn anew at each impact, from nothing to this",
        _size("e", 0.1, 0.4, 0.0, 0.95),
    ),
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
    "displacement_v_per_m": 100.0,  # of the sensor on the ball, where the profile has one
    "displacement_noise_v": 0.001,
    "shaker_frequency_hz": 0.0,  # 0: the shaker's own resonance is equalised away
    "shaker_damping": 0.5,
    # the instrument behind the sensors; 0: none of it
    "low_pass_hz": 0.0,  # accelerometer, Butterworth; its noise passes it
    "low_pass_poles": 2.0,  # 1, 2 or 4
    "high_pass_hz": 0.0,  # coupling behind the accelerometer: no constant, gravity neither, comes through
    "mount_hz": 0.0,  # resonance of the accelerometer on its mount
    "mount_damping": 0.05,  # 1: sensitivity falls with frequency
    "cross_axis": 0.0,  # part of the table's sideways acceleration that is taken for a vertical one
    "sensor_clip_g": 0.0,  # largest acceleration that the accelerometer gives
    "flicker_v": 0.0,  # 1/f noise of the accelerometer, rms in each octave
    "contact_flicker_v": 0.0,
    "bias_v": 0.0,  # in the accelerometer's volts
    "warm_up_v": 0.0,  # the same at the start, decaying
    "warm_up_s": 5.0,
    "mains_v": 0.0,  # 50 Hz in the accelerometer's volts, amplitude
    "mains_odd": 0.0,  # its harmonics 3, 5, 7: this over their number
    "contact_mains_v": 0.0,
    "drive_mains_v": 0.0,  # in the recorded drive
    "fir_samples": 0.0,  # delay of a sigma-delta converter's linear-phase filter, of all channels
    "fir_accelerometer_only": 0.0,  # 1: only the accelerometer has it
    "between_channels_s": 0.0,  # a multiplexed card takes each channel so much later than the one before
    "film_v": 0.0,  # by so much a film raises the closed contact's voltage, each time by half to one and a half of it
    "hysteresis_v": 0.0,  # width between the thresholds of a comparator behind the contact circuit
}
"""The rig around the ball: what a scenario's ``[rig]`` table may set."""


def parameter_dtype() -> np.dtype[np.void]:
    """Layout of the compiled plant's parameters: rig numbers, ``effect_parameter`` fields, then switches."""
    fields = [(name, "f8") for name in RIG_DEFAULTS]
    fields += [(f"{e.name}_{p.name}", "f8") for e in EFFECTS.values() for p in e.parameters]
    switches = (
        "has_friction",
        "has_unusual_friction",
        "has_force",
        "has_hold",
        "has_mode",
        "has_front",
        "is_ballistic",
    )
    fields += [(name, "f8") for name in (*switches, "is_simple")]
    return np.dtype(fields)
