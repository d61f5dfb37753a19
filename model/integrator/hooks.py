"""The hooks of all effects, each kind summed into one compiled function: an effect costs a file and no edit here.

The functions are written as one source from the effects found in `model.effects`, and compiled at their first call; an
effect whose parameters are absent costs next to nothing. Decision 2.
"""

from __future__ import annotations

from collections.abc import Callable

from model.effects.base import COMPILED_HOOKS
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

_SIGNATURES = {
    "gravity": ("p", "p[-1]"),
    "force": ("s, h, v, u, p", "0.0"),
    "dry_friction": ("h, speed, direction, p", "0.0"),
    "takeoff_threshold": ("dwell_s, p", "0.0"),
    "rebound": ("v, p", "0.0"),
    "plate_mode": ("p", "(1.0, 0.0, 0.0)"),
}


def _source() -> str:
    """One function a hook, each the sum of the effects' own; that of gravity begins with the local g."""
    entries = registry()
    lines = ["from kernels import njit"]
    for entry in entries:
        for hook in COMPILED_HOOKS:
            if hook in entry.hooks:
                lines.append(f"from {entry.module} import {hook} as {hook}_{entry.effect.name}")
    for hook, (arguments, nothing) in _SIGNATURES.items():
        terms = [f"{hook}_{e.effect.name}({arguments}, {e.offset})" for e in entries if hook in e.hooks]
        if hook == "plate_mode" and len(terms) > 1:
            raise ValueError("only one effect may bring a plate mode")
        total = " + ".join([nothing, *terms] if hook == "gravity" else terms) or nothing
        lines += ["", "@njit(error_model='numpy')", f"def {hook}({arguments}):", f"    return {total}"]
    return "\n".join(lines)


exec(compile(_source(), "<the hooks of all effects>", "exec"), globals())
