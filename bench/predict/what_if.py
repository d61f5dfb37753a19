"""`bench predict --what-if`: a profile with some of its values, or of its declared effects, replaced."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import ValidationError

from daq.setup.errors import InputError
from daq.setup.setup import Setup

Described = TypeVar("Described", bound=Setup)

MASS = "ball.mass_kg"
# powers of the ball's mass with which effects go: what it weighs against the table, and forces per mass
OF_MASS = {
    ("table_resonance", "mass_ratio"): 1, ("mass_loading", "relative"): 1, ("viscous_damping", "rate_per_s"): -1,
    ("quadratic_drag", "k_per_m"): -1, ("adhesion", "a_mps2"): -1, ("position_force", "spring_per_s2"): -1,
    ("position_force", "magnet_mps2"): -1,
}  # fmt: skip


def what_if(profile: Described, changes: tuple[str, ...]) -> Described:
    """The profile with ``KEY=VALUE`` of each change: a key of the profile, or ``effect.parameter``.

    With the ball's mass its weight against the table changes, and what a force does to it.

    Raises
    ------
    InputError
        For a change of another form, a key that is not there, or a value that does not fit.
    """
    data = profile.model_dump()
    for change in changes:
        key, equals, text = (part.strip() for part in change.partition("="))
        try:
            value = float(text)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--what-if wants KEY=NUMBER, such as ball.mass_kg=0.1, not {change!r}")
        if key == MASS:
            _scale_effects(data["declared"], value / profile.ball.mass_kg)
        path = key.split(".")
        table = _table_of(data, path[:-1], key, profile.name)
        table[path[-1]] = {**table[path[-1]], "value": value} if isinstance(table.get(path[-1]), dict) else value
    try:
        return type(profile).model_validate(data)
    except ValidationError as error:
        raise InputError(f"--what-if {' '.join(changes)}: {error.errors()[0]['msg']}") from error


def _table_of(data: dict[str, Any], path: list[str], key: str, name: str) -> dict[str, Any]:
    """The table that holds the last part of a key; a declared effect may be named without `declared`."""
    last, table = key.rpartition(".")[2], data
    for place in ["declared", *path] if path and path[0] in data["declared"] else path:
        table = table.get(place, {}) if isinstance(table.get(place, {}), dict) else {}
    if last not in table:
        declared = ", ".join(f"{e}.{q}" for e, own in data["declared"].items() for q in own) or "none"
        raise InputError(f"--what-if {key}: profile {name!r} has no such value; its declared effects: {declared}")
    return table


def _scale_effects(declared: dict[str, dict[str, Any]], factor: float) -> None:
    for (effect, parameter), power in OF_MASS.items():
        if quantity := declared.get(effect, {}).get(parameter):
            quantity["value"] *= factor**power
