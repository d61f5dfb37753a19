"""Declared effects by where they act: on the ball, between drive and plate, or in what the instruments show.

Each acts once. Who flies over a plate that was measured leaves the drive's effects out, because
they are in the measurement; who starts from what was asked of the drive applies them first.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import COMPILED_HOOKS, Registered
from model.effects.registry import effect

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
