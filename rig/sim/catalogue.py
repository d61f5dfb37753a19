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

RIG_DEFAULTS: dict[str, float] = _TABLES["rig"]
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
