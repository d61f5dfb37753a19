"""What the simulated rig hides: its effects, scenario files, read strictly, and scenarios drawn by chance for scoring.

Its effects are listed in `effects.toml`: the layout of the compiled plant's parameters, the strictness of scenario
files, the sealed draws and the documentation all come from there. A parameter at its neutral value does nothing.

A scenario is known outside only by a hash of its canonical content and a nonce, so that it cannot be found by trying
likely contents; nothing else of it leaves this package. A sealed one has effects drawn at a stated strength, unknown to
whoever analyses the run. All chance comes from the generator passed in, and a draw is a plain `Scenario`, so that its
truth can be stored elsewhere and opened after the verdict is written. Decisions 272 and 449.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from daq.setup.errors import InputError
from daq.setup.setup import Setup
from rig.sim.instrument import ANALOGUE


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

RIG_DEFAULTS: dict[str, float] = _TABLES["rig"]
"""The rig around the ball: what a scenario's ``[rig]`` table may set."""


def parameter_dtype() -> np.dtype[np.void]:
    """Layout of the compiled plant's parameters: rig numbers, ``effect_parameter`` fields, then switches."""
    fields = [(name, "f8") for name in RIG_DEFAULTS]
    fields += [(f"{e.name}_{p.name}", "f8") for e in EFFECTS.values() for p in e.parameters]
    switches = "has_friction has_unusual_friction has_force has_hold has_mode has_front is_ballistic is_simple"
    fields += [(name, "f8") for name in switches.split()]
    return np.dtype(fields)


DRIFT = "parameter_drift"
"""Table under ``[effects]`` that makes parameters of other effects drift: ``"effect.parameter" = per_minute``."""

DRIFT_DTYPE = np.dtype([("place", "i8"), ("base", "f8"), ("rate_per_s", "f8"), ("low", "f8"), ("high", "f8")])


@dataclass(frozen=True)
class Scenario:
    """What a rig hides; raises `ValueError` where a name does not exist, or a value lies outside its limits."""

    name: str  # for people; covered by the hash
    # names and parameters of `rig.sim.scenario`; parameters not given are neutral.
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    rig: Mapping[str, float] = field(default_factory=dict)  # overrides of `rig.sim.scenario.RIG_DEFAULTS`.
    drift_per_minute: Mapping[str, float] = field(default_factory=dict)
    nonce: str = ""  # random text that keeps the hash from being guessed

    def __post_init__(self) -> None:
        problems, rig = list[str](), self.rig
        for name, table in self.effects.items():
            if name not in EFFECTS:
                problems.append(f"effects.{name}: wanted one of {', '.join(EFFECTS)}")
                continue
            known = {parameter.name: parameter for parameter in EFFECTS[name].parameters}
            for key, value in table.items():
                if key not in known:
                    problems.append(f"effects.{name}.{key}: wanted one of {', '.join(known)}")
                elif not _is_number(value) or not known[key].low <= value <= known[key].high:
                    wanted = f"a number from {known[key].low:g} to {known[key].high:g}"
                    problems.append(f"effects.{name}.{key}: wanted {wanted}, got {value!r}")
        problems += [f"rig.{key}: wanted one of {', '.join(RIG_DEFAULTS)}" for key in rig if key not in RIG_DEFAULTS]
        problems += [
            f"rig.{key}: wanted a number, got {value!r}" for key, value in rig.items() if not _is_number(value)
        ]
        if rig.get("low_pass_poles", 1) not in (1, 2, 4):
            problems.append(f"rig.low_pass_poles: wanted 1, 2 or 4, got {rig['low_pass_poles']!r}")
        for dotted, rate in self.drift_per_minute.items():
            effect, _, name = dotted.partition(".")
            present = effect in self.effects and any(p.name == name for p in EFFECTS[effect].parameters)
            if not present:
                problems.append(f"effects.{DRIFT}.{dotted!r}: wanted effect.parameter of an effect in this scenario")
            elif not _is_number(rate):
                problems.append(f"effects.{DRIFT}.{dotted!r}: wanted a change per minute, got {rate!r}")
        if problems:
            raise ValueError("; ".join(problems))

    @property
    def sha256(self) -> str:
        """SHA-256 of the canonical content, nonce included, as hexadecimal."""
        content = {
            "name": self.name,
            "effects": {name: dict(table) for name, table in self.effects.items()},
            "rig": dict(self.rig),
            "drift_per_minute": dict(self.drift_per_minute),
            "nonce": self.nonce,
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def parameters(self) -> tuple[np.ndarray, np.ndarray]:
        """What the compiled plant runs on, as structured arrays: the parameters (1,) by `parameter_dtype`.

        And the drifting fields (n,) of `DRIFT_DTYPE` by their place in that record, with rates per second and limits.
        """
        dtype = parameter_dtype()
        params = np.zeros(1, dtype)
        for key, value in {**RIG_DEFAULTS, **self.rig}.items():
            params[key] = value
        for entry in EFFECTS.values():
            given = self.effects.get(entry.name, {})
            for parameter in entry.parameters:
                params[f"{entry.name}_{parameter.name}"] = given.get(parameter.name, parameter.neutral)
        evaluated = {EFFECTS[name].evaluated for name in self.effects}
        unusual, forced = "friction" in evaluated, "force" in evaluated
        params["has_unusual_friction"], params["has_force"] = unusual, forced
        params["has_friction"] = unusual or "coulomb_friction" in self.effects
        params["has_hold"], params["has_mode"] = "impact_hold" in self.effects, "table_resonance" in self.effects
        params["has_front"] = any(params[key][0] != 0.0 for key in ANALOGUE)
        ballistic = not (unusual or forced or "table_resonance" in self.effects)
        params["is_ballistic"], params["is_simple"] = ballistic, ballistic and "contact" not in evaluated
        places = {name: place for place, name in enumerate(dtype.names or ())}
        drift = np.zeros(len(self.drift_per_minute), DRIFT_DTYPE)
        for row, (dotted, per_minute) in enumerate(self.drift_per_minute.items()):
            effect, name = dotted.split(".")
            parameter = next(p for p in EFFECTS[effect].parameters if p.name == name)
            key = f"{effect}_{name}"
            drift[row] = (places[key], params[key][0], per_minute / 60.0, parameter.low, parameter.high)
        return params, drift

    def to_toml(self) -> str:
        """The scenario as a file that `load_scenario` reads back to the same hash."""
        lines = [f"name = {json.dumps(self.name)}", f"nonce = {json.dumps(self.nonce)}"]
        if self.rig:
            lines += ["", "[rig]", *(f"{key} = {float(value)!r}" for key, value in self.rig.items())]
        for name, table in self.effects.items():
            lines += ["", f"[effects.{name}]", *(f"{key} = {float(value)!r}" for key, value in table.items())]
        if self.drift_per_minute:
            rates = (f'"{key}" = {float(value)!r}' for key, value in self.drift_per_minute.items())
            lines += ["", f"[effects.{DRIFT}]  # per minute", *rates]
        return "\n".join(lines) + "\n"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file.

    Raises `InputError` where the file is missing, is no TOML, or names something that does not exist; all faults at
    once.

    It is TOML with ``name``, and optionally ``nonce``, ``[rig]``, ``[effects.NAME]`` tables and
    ``[effects.parameter_drift]`` with ``"effect.parameter" = change per minute``.
    """
    try:
        raw: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: wanted a scenario file, got: {error.strerror}; name an existing file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: wanted TOML text, got: {error}; correct that line") from error
    unknown = set(raw) - {"name", "nonce", "rig", "effects"}
    tables = {"rig": raw.get("rig", {}), "effects": raw.get("effects", {})}
    if isinstance(tables["effects"], dict):
        tables |= {f"effects.{name}": table for name, table in tables["effects"].items()}
    wrong = [key for key, table in tables.items() if not isinstance(table, dict)]
    if unknown or wrong:
        found = ", ".join([*sorted(unknown), *wrong])
        wanted = "name, nonce, and the tables [rig], [effects.NAME]"
        raise InputError(f"{path}: {found}: wanted {wanted}; see docs/reference/scenarios.md")
    effects = dict(tables["effects"])
    drift = effects.pop(DRIFT, {})
    try:
        return Scenario(str(raw.get("name", path.stem)), effects, tables["rig"], drift, str(raw.get("nonce", "")))
    except ValueError as error:
        raise InputError(f"{path}: {error}; see docs/reference/scenarios.md for the names") from error


Strength = Literal["weak", "medium", "strong"]

STRENGTHS: dict[str, tuple[float, float]] = {"weak": (1.0, 3.0), "medium": (3.0, 5.0), "strong": (5.0, 100.0)}
"""Typical residual in units of the noise floor, and least size in units of what a calibration leaves open."""

NUISANCES = ("contact_gap", "contact_closure")
"""Effects of the contact circuit only: never the one to be found, but may be added."""

INVISIBLE = ("clock_error", "restitution_scatter")
"""Where drive and recording share one clock, the motion keeps its phases and only the table's ringing changes pitch. A
rebound that scatters needs one to scatter about."""


def pool(kind: Literal["named", "beyond", "covariate"]) -> tuple[str, ...]:
    """Names to draw from: the agreed ones, those beyond them, or of these the smooth terms of one covariate."""
    if kind == "named":
        return tuple(entry.name for entry in NAMED if entry.name not in NUISANCES + INVISIBLE)
    return tuple(entry.name for entry in BEYOND if kind == "beyond" or entry.covariate)


def left_open(setup: Setup) -> dict[tuple[str, str], float]:
    """Size of each effect that the stated uncertainties of a rig's calibrations allow, by effect and parameter.

    Gravity enters only through gamma, so it is no better known than the scales of acceleration.
    """
    drive, sensitivity = setup.drive, setup.channels.accelerometer.sensitivity
    reads = sensitivity.uncertainty / abs(sensitivity.value)
    out = {("accelerometer_gain", "relative"): reads, ("local_gravity", "relative"): reads}
    if drive.g_per_volt is not None:
        out["drive_gain", "relative"] = drive.g_per_volt.uncertainty / abs(drive.g_per_volt.value)
        lag_s = np.radians(drive.phase_deg.uncertainty) / (2.0 * np.pi * setup.forcing.frequency_hz)
        out["phase_lag", "time_constant_s"] = float(lag_s)
    return out


def sealed_scenario(
    rng: np.random.Generator,
    names: Sequence[str],
    *,
    strength: Strength = "strong",
    count: int = 1,
    allowed: Mapping[tuple[str, str], float] = MappingProxyType({}),
    drift: bool = False,
    nuisances: bool = False,
) -> Scenario:
    """Draw what a rig hides; raises `ValueError` where more effects are asked for than named.

    The nonce is fresh.

    Parameters
    ----------
    rng : numpy.random.Generator
    names : sequence of str
        Effects to draw from, without repetition; see `pool`.
    strength : {"weak", "medium", "strong"}
        Size of each effect: its typical residual over the noise floor, by `STRENGTHS`.
    count : int
        How many effects (2 for a pair, 0 for a clean rig).
    allowed : mapping
        Uncertainties of the rig's calibrations, by effect and parameter, from `left_open`: what they allow is no
        effect yet, so one that looks like a calibration has at least as many of them as its strength has noise floors.
    drift : bool
        Let the first effect's size drift by half to all of itself in a minute.
    nuisances : bool
        Add a contact gap of 0.05 to 0.5 micrometres and contact bounce of up to 0.5 ms.
    """
    if not 0 <= count <= len(names):
        raise ValueError(f"count: wanted 0 to {len(names)} effects of those named, got {count}")
    chosen = [str(name) for name in rng.permutation(np.array(list(names), dtype=object))[:count]]
    effects = {name: _draw(rng, EFFECTS[name], strength, allowed) for name in chosen}
    rates: dict[str, float] = {}
    if drift and chosen:
        for parameter in EFFECTS[chosen[0]].parameters:
            if parameter.scales:
                change = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.5, 1.0))
                rates[f"{chosen[0]}.{parameter.name}"] = change * effects[chosen[0]][parameter.name]
    rig: dict[str, float] = {}
    if nuisances:
        effects |= {"contact_gap": {"gap_m": float(rng.uniform(5e-8, 5e-7))}}
        rig["bounce_s"] = float(rng.uniform(0.0, 5e-4))
    return Scenario("sealed", effects, rig, rates, rng.bytes(16).hex())


def ordinary_instrument(rng: np.random.Generator) -> dict[str, float]:
    """Keys of ``[rig]`` of a laboratory's instrument, drawn within what a profile states of its channels."""
    return {
        "low_pass_hz": float(np.exp(rng.uniform(np.log(4e3), np.log(9e3)))),
        "low_pass_poles": float(rng.choice((1, 2, 4))),
        "flicker_v": float(np.exp(rng.uniform(np.log(3e-5), np.log(2e-4)))),
        "bias_v": float(rng.uniform(-3e-4, 3e-4)),
        "mains_v": float(rng.uniform(0.0, 3e-4)),
        "mains_odd": 0.5,
        "between_channels_s": float(rng.uniform(0.0, 5e-6)),
        "bounce_s": float(rng.uniform(0.0, 5e-4)),
        "film_v": float(rng.uniform(0.0, 0.1)),
        "cross_axis": float(rng.uniform(0.0, 5e-3)),
        "sensor_clip_g": float(np.exp(rng.uniform(np.log(5.0), np.log(20.0)))),
    }


def instrument_in_words(rig: Mapping[str, float]) -> str:
    """What `ordinary_instrument` has drawn, for a person."""
    return (
        f"accelerometer behind a low-pass of {rig['low_pass_hz'] / 1e3:.1f} kHz (order {rig['low_pass_poles']:.0f}), "
        f"1/f noise of {1e3 * rig['flicker_v']:.2f} mV an octave, bias {1e3 * rig['bias_v']:.2f} mV, mains "
        f"{1e3 * rig['mains_v']:.2f} mV, cross-axis {100.0 * rig['cross_axis']:.2f} %, range "
        f"{rig['sensor_clip_g']:.1f} g; channels {1e6 * rig['between_channels_s']:.1f} us late each; a contact that "
        f"chatters for up to {1e3 * rig['bounce_s']:.2f} ms, with a film of {rig['film_v']:.2f} V"
    )


def _draw(
    rng: np.random.Generator, entry: EffectEntry, strength: Strength, allowed: Mapping[tuple[str, str], float]
) -> dict[str, float]:
    """Values of one effect: shapes from their ranges, sizes scaled to the strength but never above the strong range."""
    low, high = STRENGTHS[strength]
    # strengths are meant against a noise floor of 10 us of landing time
    target_us = 10.0 * float(np.exp(rng.uniform(np.log(low), np.log(high))))
    share = min(0.01 * target_us / entry.unit_us, 1.0)
    values: dict[str, float] = {}
    for parameter in entry.parameters:
        if not parameter.scales:
            values[parameter.name] = float(rng.uniform(*parameter.strong))
            continue
        middle = 0.5 * sum(parameter.strong)
        size = max(share * middle * rng.uniform(0.8, 1.25), low * allowed.get((entry.name, parameter.name), 0.0))
        if parameter.low < 0.0 and rng.random() < 0.5:
            size = -size
        values[parameter.name] = float(np.clip(size, parameter.low, parameter.high))
    # most rods rub alike up and down
    if entry.name == "coulomb_friction" and rng.random() < 0.7:
        values["mu_down"] = values["mu_up"]
    return values
