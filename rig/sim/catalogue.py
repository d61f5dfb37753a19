"""Every effect the simulated rig can hide, as `effects.toml` lists them, and the rig around them.

The layout of the compiled plant's parameter record, the strictness of scenario files, the sealed draws and the
documentation all come from that file. A parameter at its neutral value does nothing. Decision 449.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Parameter:
    """One number of an effect."""

    name: str  # name within the effect; carries the unit where it has one
    strong: tuple[float, float]  # range drawn from when the effect is strong
    scales: bool = True  # True where strength multiplies this number; False where it only shapes the effect
    neutral: float = 0.0  # the value at which the effect is absent (shape parameters: any harmless value)
    low: float = -np.inf  # least value accepted in a scenario file
    high: float = np.inf  # largest one


@dataclass(frozen=True)
class EffectEntry:
    """One effect that can be hidden."""

    name: str  # name used in scenario files
    parameters: tuple[Parameter, ...]
    words: str  # what it does
    # microseconds by which one hundredth of the middle of the strong range typically moves the next landing or
    # take-off (or what is as easily seen in another channel); strengths are drawn in these units
    unit_us: float
    named: bool = True  # True where the effect has an agreed name among the candidates; False for effects beyond them
    # what the plant evaluates of it between events: force, friction (that is not constant) or contact; else
    # empty
    evaluated: str = ""
    covariate: str = ""  # where the effect is a smooth term of one covariate: which; else empty


def _read(tables: dict[str, dict[str, Any]], *, named: bool) -> tuple[EffectEntry, ...]:
    """Entries of one part of the file; what is no table there belongs to the effect, each table is a parameter."""
    found = []
    for name, table in tables.items():
        parameters = []
        for key, row in ((k, x) for k, x in table.items() if isinstance(x, dict)):
            low, high = row.get("limits", (row.get("least", 1e-12), np.inf))
            parameters.append(Parameter(key, tuple(row["strong"]), "limits" in row, row.get("neutral", 0.0), low, high))
        own = {key: x for key, x in table.items() if not isinstance(x, dict)}
        found.append(EffectEntry(name, tuple(parameters), named=named, **own))
    return tuple(found)


_TABLES = tomllib.loads(files(__package__).joinpath("effects.toml").read_text(encoding="utf-8"))

NAMED: tuple[EffectEntry, ...] = _read(_TABLES["named"], named=True)

BEYOND: tuple[EffectEntry, ...] = _read(_TABLES["beyond"], named=False)

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
