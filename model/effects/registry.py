"""The library of effects: the files of this folder, of installed packages and of the user, and their parameters' row.

Effects are read once and checked as they are read: a file that would be an effect without effect is refused.
Decision 2.

A declared effect acts on the ball, between drive and plate, or in what the instruments show, and each acts once. Who
flies over a plate that was measured leaves the drive's effects out, because they are in the measurement; who starts
from what was asked of the drive applies them first.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import importlib.metadata
import operator
import pkgutil
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import numpy as np

import model.effects
from kernels.arrays import Complexes, Floats
from kernels.errors import InputError
from model.effects import user_effects
from model.effects.base import COMPILED_HOOKS, PLAIN_HOOKS, SIGNATURES, Effect, Parameter, Registered
from model.effects.user_effects import EffectFileError

__all__ = [
    "Effect", "Parameter", "Registered", "effect", "null_row", "offsets", "registry", "resolve", "row", "trend_name",
]  # fmt: skip

NOT_EFFECTS = frozenset({"base", "curves", "registry", "user_effects"})
ENTRY_POINTS = "shakerbench.effects"


@functools.cache
def registry() -> tuple[Registered, ...]:
    """All effects in alphabetical order, with their places in the row of all parameters.

    Raises `EffectFileError` for a file without ``EFFECT``, a name that is not its file's or is taken, an unknown hook,
    an effect without hooks, and names in ``variants``, ``tied``, ``special_cases`` or ``confused_with`` that do not
    exist.
    """
    found: dict[str, tuple[Effect, str, dict[str, Any]]] = {}
    for module in _modules():
        e, hooks = _checked(module)
        if e.name in found:
            raise _taken(_file(module), e.name, found[e.name][1])
        found[e.name] = (e, module.__name__, hooks)
    for path in user_effects.effect_files():
        if path.stem in found or path.stem in NOT_EFFECTS:
            raise _taken(str(path), path.stem, found[path.stem][1] if path.stem in found else "model.effects")
        module = user_effects.load(path)
        e, hooks = _checked(module)
        for hook in hooks.keys() & SIGNATURES.keys():
            user_effects.check_signature(str(path), hook, hooks[hook], SIGNATURES[hook])
        found[e.name] = (e, module.__name__, hooks)
    for e, name, _ in found.values():
        _refuse_unknown(name, "confused_with or special_cases", {*e.confused_with, *e.special_cases}, found)
    out, offset = [], 0
    for key in sorted(found):
        e, name, hooks = found[key]
        out.append(Registered(e, offset, name, hooks))
        offset += len(e.parameters)
    return tuple(out)


def _modules() -> Iterator[ModuleType]:
    """Installed modules that hold an effect each."""
    for info in pkgutil.iter_modules(model.effects.__path__):
        if info.name not in NOT_EFFECTS:
            yield importlib.import_module(f"{model.effects.__name__}.{info.name}")
    for point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        yield importlib.import_module(point.module)


def _taken(file: str, name: str, where: str) -> EffectFileError:
    return EffectFileError(f"{file}: effect {name} exists already in {where}; rename one of them")


def _checked(module: ModuleType) -> tuple[Effect, dict[str, Any]]:
    """Effect and hooks of a file; refused where they cannot be meant."""
    file, e = _file(module), getattr(module, "EFFECT", None)
    if not isinstance(e, Effect):
        raise EffectFileError(f"{file}: wanted EFFECT = Effect(...), found {'nothing' if e is None else repr(e)}")
    own = module.__name__.rpartition(".")[2]
    if e.name != own:
        raise EffectFileError(f"{file}: the effect is called {e.name!r}; wanted the file's name, {own!r}")
    known = COMPILED_HOOKS + PLAIN_HOOKS
    # the public functions that the module defines itself, not those that it imports
    own_functions = [
        k
        for k, f in vars(module).items()
        if callable(f) and not isinstance(f, type) and getattr(f, "__module__", "") == module.__name__
    ]
    for name in (k for k in own_functions if not k.startswith("_")):
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"hooks are {', '.join(known)}"
            raise EffectFileError(f"{file}: no hook is called {name!r}; {hint} (a function of its own begins with _)")
    _refuse_unknown(file, "hook", {q.hook for q in e.parameters if q.hook}, set(PLAIN_HOOKS))
    plain = {q.hook: operator.itemgetter(q.name) for q in e.parameters if q.hook}
    hooks = {k: getattr(module, k, None) or plain[k] for k in known if hasattr(module, k) or k in plain}
    if not hooks and not e.is_trend:
        raise EffectFileError(f"{file}: wanted at least one hook, found none; hooks are {', '.join(known)}")
    names = {q.name for q in e.parameters}
    _refuse_unknown(file, "variants", {q for variant in e.variants for q in variant}, names)
    _refuse_unknown(file, "tied", {q for group in e.tied.values() for q in group}, names)
    _refuse_unknown(file, "special_cases", {q for case in e.special_cases.values() for q in case.values()}, names)
    return e, hooks


def _file(module: ModuleType) -> str:
    return module.__file__ or module.__name__


def _refuse_unknown(file: str, field: str, named: set[str], known: Mapping[str, object] | set[str]) -> None:
    """Refuse names that do not exist."""
    for name in sorted(named - set(known)):
        raise EffectFileError(
            f"{file}: {field} names {name!r}, which does not exist; known are {', '.join(sorted(known))}"
        )


@functools.cache
def offsets() -> dict[tuple[str, str], int]:
    """Place of every parameter in the row, by ``(effect, parameter)``."""
    return {(r.effect.name, q.name): r.offset + i for r in registry() for i, q in enumerate(r.effect.parameters)}


@functools.cache
def trend_name() -> str:
    """Name of the effect that stands for a trend of another effect's parameter."""
    return next(r.effect.name for r in registry() if r.effect.is_trend)


@functools.cache
def _by_name() -> dict[str, Registered]:
    return {r.effect.name: r for r in registry()}


def effect(name: str) -> Registered:
    """The registered effect called ``name``; raises `InputError` when there is none; the message names the nearest."""
    entry = _by_name().get(name)
    if entry is not None:
        return entry
    known = [r.effect.name for r in registry() if r.effect.library]
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else f"; known are {', '.join(known)}"
    raise InputError(f"no effect is called {name!r}{hint}")


def unit_of(name: str, parameter: str) -> str:
    """Unit of a parameter, or of its trend (``name@...``), as printed; empty where it has none or is not known."""
    known = _by_name().get(name)
    found = () if known is None else known.effect.parameters
    unit = next((q.unit for q in found if q.name == parameter.partition("@")[0]), "")
    return "" if unit == "1" else unit


def resolve(declared: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Check names and bounds of ``declared`` effects and fill in the parameters left out.

    Tied parameters may be given by their common name (``mu`` of ``coulomb_friction``).

    Raises `InputError` for an unknown effect or parameter, or a value outside its bounds.
    """
    resolved: dict[str, dict[str, float]] = {}
    for name, given in declared.items():
        e = effect(name).effect
        values, table = e.null_values, dict(given)
        for common, group in e.tied.items():
            if common in table:
                table = {**dict.fromkeys(group, table.pop(common)), **table}
        for key, value in table.items():
            parameter = e.parameter(key)
            if not parameter.low <= value <= parameter.high:
                raise InputError(
                    f"{name}.{key} = {value:g} {parameter.unit} is outside {parameter.low:g} .. {parameter.high:g}"
                )
            values[key] = float(value)
        resolved[name] = values
    return resolved


@functools.cache
def _null_values() -> tuple[float, ...]:
    return tuple(q.null_value for r in registry() for q in r.effect.parameters)


def null_row(g_mps2: float) -> Floats:
    """The row of all parameters at their null values, shape (P + 1,); the last element is ``g_mps2``."""
    return np.array((*_null_values(), g_mps2))


def row(values: Mapping[str, Mapping[str, float]], g_mps2: float) -> Floats:
    """The row of all parameters for ``values`` by effect and parameter, shape (P + 1,); others at null values."""
    out = null_row(g_mps2)
    for name, table in resolve(values).items():
        for key, value in table.items():
            out[offsets()[name, key]] = value
    return out


Effects = Mapping[str, Mapping[str, float]]


def ball_effects(effects: Effects) -> dict[str, dict[str, float]]:
    """Effects that act on the ball's flight, its take-off or its impact."""
    return {n: dict(t) for n, t in effects.items() if effect(n).hooks.keys() & set(COMPILED_HOOKS)}


def accelerometer_response(effects: Effects, omega_radps: Floats) -> Complexes:
    """Factor by which the accelerometer reads too much, and late, at each frequency."""
    factors = (e.hooks["accelerometer_response"](t, omega_radps) for e, t in _with(effects, "accelerometer_response"))
    return functools.reduce(np.multiply, factors, np.ones(np.shape(omega_radps), dtype=np.complex128))


def plate_gain(effects: Effects, accel_g: float) -> float:
    """Plate motion over what the drive asks for, where that has the mean square of one tone of ``accel_g``.

    A pure delay moves the whole pattern, not its size; the named effects treat all tones alike.
    """
    omega, asked = np.ones(1), np.array([accel_g])
    factors = [e.hooks["transfer"](dict(t), omega, asked)[0] for e, t in _with(effects, "transfer")]
    return float(np.abs(np.prod(factors)))


def shapes_the_plate(effects: Effects) -> list[str]:
    """Names of declared effects that give the plate a motion of undeclared phase."""
    hooks = ("harmonics", "hum_mps2", "modulation")
    return sorted({e.effect.name for hook in hooks for e, _ in _with(effects, hook)})


def _with(effects: Effects, hook: str) -> list[tuple[Registered, Mapping[str, float]]]:
    found = ((effect(n), t) for n, t in effects.items())
    return [(e, {**e.effect.null_values, **t}) for e, t in found if hook in e.hooks]
