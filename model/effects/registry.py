"""The effects found in this folder, their hooks, and the row of all their parameters."""

from __future__ import annotations

import difflib
import functools
import importlib
import pkgutil
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

import model.effects
from model.effects.base import COMPILED_HOOKS, PLAIN_HOOKS, Effect, Parameter, Registered

__all__ = ["Effect", "Parameter", "Registered", "absent_row", "effect", "offsets", "registry", "resolve", "row"]

NOT_EFFECTS = frozenset({"base", "registry", "routing"})


@functools.cache
def registry() -> tuple[Registered, ...]:
    """All effects in alphabetical order, with their places in the row of all parameters."""
    found, offset = [], 0
    for info in sorted(pkgutil.iter_modules(model.effects.__path__), key=lambda i: i.name):
        if info.name in NOT_EFFECTS:
            continue
        name = f"{model.effects.__name__}.{info.name}"
        module = importlib.import_module(name)
        hooks = {h: getattr(module, h) for h in COMPILED_HOOKS + PLAIN_HOOKS if hasattr(module, h)}
        found.append(Registered(module.EFFECT, offset, name, hooks))
        offset += len(module.EFFECT.parameters)
    return tuple(found)


@functools.cache
def offsets() -> dict[tuple[str, str], int]:
    """Place of every parameter in the row, by ``(effect, parameter)``."""
    return {(r.effect.name, q.name): r.offset + i for r in registry() for i, q in enumerate(r.effect.parameters)}


def effect(name: str) -> Registered:
    """The registered effect called ``name``.

    Raises
    ------
    ValueError
        When there is none; the message names the nearest.
    """
    for entry in registry():
        if entry.effect.name == name:
            return entry
    known = [r.effect.name for r in registry() if r.effect.library]
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else f"; known are {', '.join(known)}"
    raise ValueError(f"no effect is called {name!r}{hint}")


def resolve(declared: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Check names and bounds of ``declared`` effects and fill in the parameters left out.

    ``coulomb_friction`` also takes ``mu`` for both directions.

    Raises
    ------
    ValueError
        For an unknown effect or parameter, or a value outside its bounds.
    """
    resolved: dict[str, dict[str, float]] = {}
    for name, given in declared.items():
        entry = effect(name)
        values = entry.effect.absent
        table = dict(given)
        if name == "coulomb_friction" and "mu" in table:
            mu = table.pop("mu")
            table = {"mu_up": mu, "mu_down": mu, **table}
        for key, value in table.items():
            parameter = entry.effect.parameter(key)
            if not parameter.low <= value <= parameter.high:
                raise ValueError(
                    f"{name}.{key} = {value:g} {parameter.unit} is outside {parameter.low:g} .. {parameter.high:g}"
                )
            values[key] = float(value)
        resolved[name] = values
    return resolved


@functools.cache
def _absent() -> tuple[float, ...]:
    return tuple(q.absent for r in registry() for q in r.effect.parameters)


def absent_row(g_mps2: float) -> NDArray[np.float64]:
    """The row of all parameters with every effect absent, shape (P + 1,); the last element is ``g_mps2``."""
    return np.array((*_absent(), g_mps2))


def row(values: Mapping[str, Mapping[str, float]], g_mps2: float) -> NDArray[np.float64]:
    """The row of all parameters for ``values`` by effect and parameter, shape (P + 1,); the others are absent."""
    out = absent_row(g_mps2)
    for name, table in resolve(values).items():
        for key, value in table.items():
            out[offsets()[name, key]] = value
    return out
