"""Scenario files: what the simulated rig hides, read strictly, and known outside only by a hash.

The hash covers the canonical content and a nonce, so it cannot be found by trying likely
contents; nothing else of a scenario leaves this package.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from daq.setup.errors import InputError
from rig.sim.catalogue import EFFECTS, RIG_DEFAULTS, parameter_dtype
from rig.sim.instrument import ANALOGUE

DRIFT = "parameter_drift"
"""Table under ``[effects]`` that makes parameters of other effects drift: ``"effect.parameter" = per_minute``."""

DRIFT_DTYPE = np.dtype([("place", "i8"), ("base", "f8"), ("rate_per_s", "f8"), ("low", "f8"), ("high", "f8")])


@dataclass(frozen=True)
class Scenario:
    """What a rig hides.

    Raises `ValueError` where an effect, a parameter or a rig key does not exist, or a value lies outside its limits.
    """

    name: str  # for people; covered by the hash
    # names and parameters of `rig.sim.catalogue`; parameters not given are neutral.
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    rig: Mapping[str, float] = field(default_factory=dict)  # overrides of `rig.sim.catalogue.RIG_DEFAULTS`.
    drift_per_minute: Mapping[str, float] = field(default_factory=dict)
    nonce: str = ""  # random text that keeps the hash from being guessed

    def __post_init__(self) -> None:
        problems = _problems(self)
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
        """What the compiled plant runs on.

        Returns
        -------
        parameters : structured array (1,)
            Layout of `rig.sim.catalogue.parameter_dtype`.
        drift : structured array (n,) of `DRIFT_DTYPE`
            The drifting fields by their place in the record, with rates per second and limits.
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
        params["has_friction"] = unusual or self._has("coulomb_friction")
        params["has_hold"], params["has_mode"] = self._has("impact_hold"), self._has("table_resonance")
        params["has_front"] = any(params[key][0] != 0.0 for key in ANALOGUE)
        ballistic = not (unusual or forced or self._has("table_resonance"))
        params["is_ballistic"], params["is_simple"] = ballistic, ballistic and "contact" not in evaluated
        places = {name: place for place, name in enumerate(dtype.names or ())}
        drift = np.zeros(len(self.drift_per_minute), DRIFT_DTYPE)
        for row, (dotted, per_minute) in enumerate(self.drift_per_minute.items()):
            effect, name = dotted.split(".")
            parameter = next(p for p in EFFECTS[effect].parameters if p.name == name)
            key = f"{effect}_{name}"
            drift[row] = (places[key], params[key][0], per_minute / 60.0, parameter.low, parameter.high)
        return params, drift

    def _has(self, *names: str) -> bool:
        return any(name in self.effects for name in names)

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


def _problems(scenario: Scenario) -> list[str]:
    """What is wrong with a scenario's effects, rig keys and drifts."""
    problems, rig = [], scenario.rig
    for name, table in scenario.effects.items():
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
    problems += [f"rig.{key}: wanted a number, got {value!r}" for key, value in rig.items() if not _is_number(value)]
    if rig.get("low_pass_poles", 1) not in (1, 2, 4):
        problems.append(f"rig.low_pass_poles: wanted 1, 2 or 4, got {rig['low_pass_poles']!r}")
    for dotted, rate in scenario.drift_per_minute.items():
        effect, _, name = dotted.partition(".")
        present = effect in scenario.effects and any(p.name == name for p in EFFECTS[effect].parameters)
        if not present:
            problems.append(f"effects.{DRIFT}.{dotted!r}: wanted effect.parameter of an effect in this scenario")
        elif not _is_number(rate):
            problems.append(f"effects.{DRIFT}.{dotted!r}: wanted a change per minute, got {rate!r}")
    return problems


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
