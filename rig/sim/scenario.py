"""Scenario files: what the simulated rig hides, read strictly, and known outside by a hash alone.

The rule kept here: the hash covers the canonical content and a nonce, so it cannot be found by trying likely
contents; nothing else of a scenario leaves this room.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from daq.errors import InputError
from rig.sim.catalogue import EFFECTS, RIG_DEFAULTS, parameter_dtype


@dataclass(frozen=True)
class Scenario:
    """What a rig hides.

    Attributes
    ----------
    name : str
    effects : mapping of effect name to mapping of parameter to value
    rig : mapping
        Overrides of `rig.sim.catalogue.RIG_DEFAULTS`.
    drift_per_minute : mapping of ``"effect.parameter"`` to change a minute
    nonce : str
        Random text that keeps the hash from being guessed.
    """

    name: str
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    rig: Mapping[str, float] = field(default_factory=dict)
    drift_per_minute: Mapping[str, float] = field(default_factory=dict)
    nonce: str = ""

    @property
    def sha256(self) -> str:
        """SHA-256 of the canonical content, nonce included, as hexadecimal."""
        content = {
            "name": self.name, "effects": {k: dict(v) for k, v in self.effects.items()}, "rig": dict(self.rig),
            "drift_per_minute": dict(self.drift_per_minute), "nonce": self.nonce,
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def parameters(self) -> tuple[np.ndarray, np.ndarray]:
        """Records (1,) for the compiled plant: values, and their drift per second."""
        dtype = parameter_dtype()
        params, drift = np.zeros(1, dtype), np.zeros(1, dtype)
        for key, value in {**RIG_DEFAULTS, **self.rig}.items():
            params[key] = value
        for entry in EFFECTS.values():
            given = self.effects.get(entry.name, {})
            for parameter in entry.parameters:
                params[f"{entry.name}_{parameter.name}"] = given.get(parameter.name, parameter.neutral)
        params["has_friction"] = float("coulomb_friction" in self.effects)
        params["has_mode"] = float("table_resonance" in self.effects)
        return params, drift


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file.

    Raises
    ------
    InputError
        Where the file is missing, is no TOML, or names an effect or parameter that does not exist.
    """
    path = Path(path)
    try:
        raw: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: wanted a scenario file, got: {error.strerror}; name an existing file") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: wanted TOML, got: {error}; correct that line") from error
    return Scenario(raw.get("name", path.stem), raw.get("effects", {}), raw.get("rig", {}), {}, raw.get("nonce", ""))
