"""Parameter values by effect, sorted out by what they touch: a flight, the plate as measured, or plate data only."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from analysis.residuals.plate_data.plate_observables import PLATE_HOOKS
from model.effects.base import PLATE_ONLY_HOOKS
from model.effects.registry import effect, registry

ParameterId = tuple[str, str]
Values = Mapping[ParameterId, float]
Own = tuple[tuple[ParameterId, float], ...]

TREND = "@drift"  # suffix of a parameter's trend: its change over the whole run


class AllValues(dict[ParameterId, float]):
    """All parameters that are set, sorted out once by what they touch; not changed once made."""

    @functools.cached_property
    def ordered(self) -> Own:
        """All of them, in one order whatever they were set in."""
        return tuple(sorted(self.items()))

    @functools.cached_property
    def own(self) -> dict[str, Own]:
        """Those of each effect."""
        names = dict.fromkeys(name for name, _ in self)
        return {name: tuple(item for item in self.ordered if item[0][0] == name) for name in names}

    @functools.cached_property
    def flying(self) -> Own:
        """Those that touch a flight."""
        return tuple(item for item in self.ordered if not _only_in_plate_data(item[0]))

    def of(self, names: frozenset[str]) -> Own:
        """Those of some effects."""
        return tuple(item for item in self.ordered if item[0][0] in names)


@functools.cache
def plate_effects() -> frozenset[str]:
    """Names of the effects that touch plate data only, never a flight."""
    return frozenset(r.effect.name for r in registry() if r.hooks and r.hooks.keys() <= PLATE_ONLY_HOOKS)


@functools.cache
def _only_in_plate_data(key: ParameterId) -> bool:
    """Whether a parameter touches plate data only, never a flight."""
    name, q = key[0], key[1].removesuffix(TREND)
    return name in plate_effects() or effect(name).effect.parameter(q).plate_only


@functools.cache
def calibrating_effects() -> frozenset[str]:
    """Names of the effects that change the plate's motion or the circuit as measured."""
    hooks = {"accelerometer_response", "flight_gain", "modulation", "gap_m"}
    hooks |= {"contact_delay_s", "closing_delay_s", "impact_delay_s"}
    return frozenset(r.effect.name for r in registry() if r.hooks.keys() & hooks)


@functools.cache
def ringing_effects() -> frozenset[str]:
    """Names of the effects that make the plate ring, and of what an accelerometer's high-pass shows of it."""
    return frozenset(r.effect.name for r in registry() if "plate_mode" in r.hooks) | {"accelerometer_high_pass"}


@functools.cache
def driving_effects() -> frozenset[str]:
    """Names of the effects that change plate data without a flight."""
    return frozenset(r.effect.name for r in registry() if r.hooks.keys() & (PLATE_HOOKS | {"modulation"}))
