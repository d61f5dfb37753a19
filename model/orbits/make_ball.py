"""The fastest ball that knows every effect asked for: ideal, exact with friction and restitution, or integrated."""

from __future__ import annotations

import math
from collections.abc import Mapping

from kernels.errors import InputError
from model.effects.base import COMPILED_HOOKS
from model.effects.registry import effect, resolve
from model.flight.numerics import FrictionRestitution
from model.orbits.attractor import Ball
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.orbits.integrated_ball import IntegratedBall
from model.tones import STANDARD_GRAVITY_MPS2, Forcing

EXACT = frozenset({"coulomb_friction", "restitution"})


def make_ball(
    forcing: Forcing,
    effects: Mapping[str, Mapping[str, float]],
    *,
    frequency_hz: float | None = None,
    g_mps2: float = STANDARD_GRAVITY_MPS2,
) -> Ball:
    """The ball on ``forcing`` with ``effects`` by name and parameter (`model.effects`).

    Raises `InputError` for an unknown effect or parameter or a value out of bounds, for an effect of the drive or of an
    instrument (the motion of the plate is given here), and where the frequency is needed and missing.

    The frequency of the first tone is needed where an effect has a scale of its own (a rate, a length, a speed).
    """
    values = resolve(effects)
    active = {}
    for name, table in values.items():
        entry = effect(name)
        if not entry.hooks.keys() & set(COMPILED_HOOKS):
            raise InputError(
                f"{name} acts on the drive or an instrument, not on the ball: a prediction at a given gamma has none"
            )
        if table != entry.effect.null_values:
            active[name] = table
    if not active:
        return IdealBall(forcing)
    scaled = sorted(set(active) - EXACT)
    if scaled and frequency_hz is None:
        raise InputError(f"{', '.join(scaled)} needs --frequency-hz, because it has a scale of its own")
    if active.keys() <= EXACT:
        return FrictionBall(forcing, *law_of(active, frequency_hz, g_mps2))
    if frequency_hz is None:
        raise InputError("effects in SI units need --frequency-hz")
    return IntegratedBall(forcing, active, frequency_hz, g_mps2)


def law_of(
    effects: Mapping[str, Mapping[str, float]], frequency_hz: float | None, g_mps2: float
) -> FrictionRestitution:
    """Friction and restitution of resolved effects, dimensionless (speeds in units of g/w).

    Raises `InputError` if restitution depends on speed and the frequency is missing, or friction holds the ball for
    ever.
    """
    friction = effects.get("coulomb_friction", {})
    bounce = effects.get("restitution", {})
    e1_s_per_m = bounce.get("e1_s_per_m", 0.0)
    if e1_s_per_m != 0.0 and frequency_hz is None:
        raise InputError("restitution.e1_s_per_m needs --frequency-hz, because it has a scale of its own")
    if not friction.get("mu_down", 0.0) < 1.0:
        raise InputError("coulomb_friction.mu_down must be less than 1: else the ball stays on the rod for ever")
    speed_mps = g_mps2 / (2.0 * math.pi * frequency_hz) if frequency_hz is not None else 0.0
    return FrictionRestitution(
        friction.get("mu_up", 0.0), friction.get("mu_down", 0.0), bounce.get("e0", 0.0), e1_s_per_m * speed_mps
    )
