"""What may be added to the declared model: every effect of the library in its variants, and trends in time.

The rule kept here: a candidate is a value: names, freed parameters, places to start from; nothing is judged here.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from analysis.attribution.fit import parameter_of
from analysis.residuals.forward_model import DRIFT, ForwardModel, ParameterId
from model.effects.registry import registry

UNLIKE = 0.3  # relative: a shape farther off begins a fit of its own


@dataclass(frozen=True)
class Candidate:
    """One way to add an effect: its names in reports, the parameters it frees, and where to look for them first."""

    names: tuple[str, ...]
    free: tuple[ParameterId, ...]
    starts: tuple[Mapping[ParameterId, float], ...] = ()


def candidates_of(world: ForwardModel, hints_hz: Sequence[float] = ()) -> list[Candidate]:
    """Every library effect that is not declared, in its variants, simplest first; and trends of calibrations."""
    out = []
    declared = {name for name, _ in world.base}
    for entry in registry():
        e = entry.effect
        if e.nuisance or not e.library or not entry.hooks or e.name in declared:
            continue
        for variant in e.variants or (tuple(q.name for q in e.parameters),):
            keys = tuple((e.name, q) for q in variant)
            grids = [e.parameter(q).scan or (e.parameter(q).absent,) for q in variant]
            if e.name == "table_resonance" and hints_hz:
                grids[1] = (*grids[1], *hints_hz)
            if "modulation" in entry.hooks:
                out.append(Candidate((e.name,), keys, _swelling(world, keys)))
                continue
            if e.name in ("coulomb_friction",):  # both directions together to begin with
                starts = [dict.fromkeys(keys, v) for v in (0.0, *grids[0])]
            else:
                starts = [dict(zip(keys, point, strict=True)) for point in itertools.product(*grids)]
                if all(not e.parameter(q).shape for q in variant):
                    starts.insert(0, {k: parameter_of(k).absent for k in keys})
            out.append(Candidate((e.name,), keys, tuple(starts)))
    for name, q in (("drive_gain", "relative"), ("accelerometer_gain", "relative")):
        out.append(Candidate((name, "parameter_drift"), ((name, q), (name, q + DRIFT)), ({},)))
    for name, q in world.base:
        out.append(Candidate(("parameter_drift",), ((name, q + DRIFT),), ({},)))
    return out


def _swelling(world: ForwardModel, keys: Sequence[ParameterId]) -> tuple[Mapping[ParameterId, float], ...]:
    """Where windows within the steps say that the plate's amplitude swells: its depth and frequency."""
    swells = world.evidence.swells
    hints = () if swells is None else swells.hints()
    return tuple({keys[0]: depth, keys[1]: hz} for hz, depth in hints)


def trends_of(free: Sequence[ParameterId]) -> list[Candidate]:
    """Trends of what has been accepted."""
    out = []
    for name, q in free:
        if not q.endswith(DRIFT) and not parameter_of((name, q)).shape and (name, q + DRIFT) not in free:
            out.append(Candidate((name, "parameter_drift"), ((name, q + DRIFT),), ({},)))
    both = [k for k in free if k in (("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down"))]
    if len(both) == 2:
        out.append(Candidate(("coulomb_friction", "parameter_drift"), tuple((n, q + DRIFT) for n, q in both), ({},)))
    return out


def unlike(
    starts: Sequence[tuple[float, dict[ParameterId, float]]], free: Sequence[ParameterId], *, absent: bool = False
) -> list[tuple[float, dict[ParameterId, float]]]:
    """The best start, and the best of those that what shapes the effect puts elsewhere: another pitch, another trap.

    With ``absent``, also the best one with the effect present: where data are squares, there is no slope without it.
    """
    shapes = [k for k in free if parameter_of(k).shape]
    sizes = [k for k in free if not parameter_of(k).shape]
    first = starts[0][1]

    def nothing(point: Mapping[ParameterId, float]) -> bool:
        return all(point.get(k, 0.0) == parameter_of(k).absent for k in sizes)

    others = [s for s in starts if any(abs(s[1][k] - first[k]) > UNLIKE * abs(first[k]) for k in shapes)]
    if absent and nothing(first):
        others += [s for s in starts if not nothing(s[1])]
    return [starts[0], *others[:1]]
