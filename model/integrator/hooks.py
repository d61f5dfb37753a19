"""The hooks of all effects, each kind summed into one compiled function: an effect costs a file and no edit here.

The functions are written as one source from the effects found in `model.effects`, and compiled at their first call; an
effect whose parameters are absent costs next to nothing. Decision 2.
"""

from __future__ import annotations

from collections.abc import Callable

from kernels.errors import InputError
from model.effects.base import SIGNATURES
from model.effects.registry import registry

gravity: Callable[..., float]
"""Constant downward acceleration of the ball, m/s^2, of ``(p)``: the local g and what effects add to it."""
force: Callable[..., float]
"""Sum of the effects' accelerations, m/s^2, of ``(s, h, v, u, p)``."""
dry_friction: Callable[..., float]
"""Sum of dry frictions, m/s^2, of ``(h, speed, direction, p)``."""
takeoff_threshold: Callable[..., float]
"""Sum of take-off thresholds, m/s^2, of ``(dwell_s, p)``."""
rebound: Callable[..., float]
"""Coefficient of restitution, of ``(v, p)``."""
plate_mode: Callable[..., tuple[float, float, float]]
"""Plate mode struck by impacts: angular frequency, damping ratio, mass ratio, of ``(p)``."""

_NOTHING = {"gravity": "p[-1]", "plate_mode": "(1.0, 0.0, 0.0)"}  # else 0


def _source() -> str:
    """One function a hook, each the sum of the effects' own; that of gravity begins with the local g."""
    entries = registry()
    lines = ["from kernels import njit"]
    for e in entries:
        lines += [f"from {e.module} import {hook} as {hook}_{e.effect.name}" for hook in SIGNATURES if hook in e.hooks]
    for hook, signature in SIGNATURES.items():
        arguments, nothing = signature.removesuffix(", k"), _NOTHING.get(hook, "0.0")
        terms = [f"{hook}_{e.effect.name}({arguments}, {e.offset})" for e in entries if hook in e.hooks]
        if hook == "plate_mode" and len(terms) > 1:
            raise InputError("only one effect may bring a plate mode")
        total = " + ".join([nothing, *terms] if hook == "gravity" else terms) or nothing
        lines += ["", "@njit(error_model='numpy')", f"def {hook}({arguments}):", f"    return {total}"]
    return "\n".join(lines)


exec(compile(_source(), "<the hooks of all effects>", "exec"), globals())
