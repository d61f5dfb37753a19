"""What may be fitted: calibrations, nuisances and declared effects with their priors, and candidates to be added.

A candidate is a value: names of effects of the library in one of their variants or of linear trends, freed parameters,
places to start from.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import Observations
from analysis.residuals.plate_data.plate_observables import SECOND, share_of_first
from analysis.residuals.values import TREND, ParameterId
from daq.setup.setup import Setup
from model.effects.registry import Effect, Parameter, effect, registry, trend_name


@dataclass(frozen=True)
class Prior:
    """Mean and standard deviation of a parameter before the run, in the parameter's own unit."""

    mean: float
    sigma: float


def priors_of(setup: Setup) -> dict[ParameterId, Prior]:
    """Priors of calibrations, nuisances and declared effects, from the profile and from the effects' own files."""
    stated = dict(_stated(setup))
    out = {
        (r.effect.name, q.name): stated.get(q.stated_by, Prior(q.null_value, q.calibration))
        for r in registry()
        for q in r.effect.parameters
        if (q.calibration > 0.0 or q.stated_by in stated) and r.effect.library
    }
    for name, table in setup.declared.items():
        for key, quantity in table.items():
            if quantity.uncertainty > 0:
                out[name, key] = Prior(quantity.value, quantity.uncertainty)
            else:
                out.pop((name, key), None)
    return out


def _stated(setup: Setup) -> Iterator[tuple[str, Prior]]:
    """Uncertainties that the profile states, by `Parameter.stated_by`."""
    drive, sensitivity = setup.drive, setup.channels.accelerometer.sensitivity
    if drive.g_per_volt is None:
        # a drive without a declared scale: its gain may be wrong ten times over, its delay by a second
        yield "drive.g_per_volt", Prior(0.0, 10.0)
        yield "drive.phase_deg", Prior(0.0, 1.0)
    else:
        if drive.g_per_volt.uncertainty > 0:
            yield "drive.g_per_volt", Prior(0.0, drive.g_per_volt.uncertainty / abs(drive.g_per_volt.value))
        if drive.phase_deg.uncertainty > 0:
            seconds = math.radians(drive.phase_deg.uncertainty) / (2 * math.pi * setup.forcing.frequency_hz)
            yield "drive.phase_deg", Prior(0.0, seconds)
    if sensitivity.uncertainty > 0:
        yield "accelerometer.sensitivity", Prior(0.0, sensitivity.uncertainty / abs(sensitivity.value))
    if setup.g_mps2.uncertainty > 0:
        yield "g_mps2", Prior(0.0, setup.g_mps2.uncertainty)


@functools.cache
def parameter_of(key: ParameterId) -> Parameter:
    """The parameter behind a key; a trend has the size of its parameter and no bound but that."""
    name, q = key
    parameter = effect(name).effect.parameter(q.removesuffix(TREND))
    if not q.endswith(TREND):
        return parameter
    span = parameter.high - parameter.low
    return Parameter(q, parameter.unit, -span, span, parameter.scale, meaning="change over the run")


def null_value_of(key: ParameterId) -> float:
    """The value at which a parameter does nothing."""
    return parameter_of(key).null_value


@functools.cache
def scale_of(key: ParameterId) -> float:
    """Size of a parameter that is one unit of its coordinate."""
    q = parameter_of(key)
    return float(q.scale ** (1.0 / q.power))


def coordinate_of(key: ParameterId, value: float) -> float:
    """Coordinate of a value: a size of one scale is about one."""
    return math.copysign(abs(value) ** (1.0 / parameter_of(key).power), value) / scale_of(key)


@functools.cache
def _axis(key: ParameterId) -> tuple[float, float, float, float]:
    """Size of a unit of the coordinate, power, and bounds of the parameter."""
    q = parameter_of(key)
    return scale_of(key), q.power, q.low, q.high


def value_at(key: ParameterId, x: float) -> float:
    """Value at a coordinate, within the parameter's bounds."""
    scale, power, low, high = _axis(key)
    y = x * scale
    return min(max(y if power == 1.0 else math.copysign(abs(y) ** power, y), low), high)


Point = dict[ParameterId, float]


@dataclass(frozen=True)
class Candidate:
    """One way to add an effect: its names in reports, the parameters it frees, and where to look for them first."""

    names: tuple[str, ...]
    free: tuple[ParameterId, ...]
    starts: tuple[Mapping[ParameterId, float], ...] = ()


def candidates_of(model: ForwardModel, seen: Mapping[ParameterId, float] | None = None) -> list[Candidate]:
    """Every library effect that is not declared, in its variants, simplest first; and trends of calibrations.

    What an earlier selection has ``seen`` of the same recordings starts there only: by now calibrations may have taken
    its place, so that any smaller size looks better.
    """
    out = []
    declared = {name for name, _ in model.base}
    for entry in registry():
        e = entry.effect
        if e.nuisance or not e.library or not entry.hooks or e.name in declared:
            continue
        if model.observations.ringing.quiet and any(q.hint == "slow_line_hz" for q in e.parameters):
            continue
        for variant in e.variants or (tuple(q.name for q in e.parameters if not q.covariate),):
            starts = _starts(model.observations, e, variant, seen or {})
            if starts:  # a modulation that no step shows begins nowhere
                out.append(Candidate((e.name,), tuple((e.name, q) for q in variant), tuple(starts)))
    drifting = [(r.effect.name, q.name) for r in registry() for q in r.effect.parameters if q.drifts]
    out += [Candidate((name, trend_name()), ((name, q), (name, q + TREND)), ({},)) for name, q in drifting]
    # a parameter that stands for a quantity of the flight has no drift: it already varies with the flight
    base = [(n, q) for n, q in model.base if not effect(n).effect.parameter(q.removesuffix(TREND)).covariate]
    base = [(n, q) for n, q in base if "rebound_scatter" not in effect(n).hooks]  # no residual shifts with a scatter
    out += [Candidate((trend_name(),), ((name, q + TREND),), ({},)) for name, q in base]
    return out


def _starts(
    observations: Observations, e: Effect, variant: Sequence[str], before: Mapping[ParameterId, float]
) -> list[Point]:
    """Places to start from: those that the data suggest, or a grid, and the null values where they have a slope."""
    parameters, keys = [e.parameter(q) for q in variant], [(e.name, q) for q in variant]
    if set(keys) <= before.keys():
        return [{k: before[k] for k in keys}]
    if any(q.hint == "modulation_hz" for q in parameters):
        hints = () if observations.modulation is None else observations.modulation.hints()
        suggested = [{"modulation_hz": hz, "modulation_depth": depth} for hz, depth in hints]
        return [{k: x[q.hint] for k, q in zip(keys, parameters, strict=True)} for x in suggested]
    grids = [q.start_grid or (q.null_value,) for q in parameters]
    if set(variant) in map(set, e.tied.values()):
        return [dict.fromkeys(keys, v) for v in (parameters[0].null_value, *grids[0])]
    mode = observations.ringing.mode
    known = {} if mode is None else mode.measured()
    seen = [(known[k][0],) if k in known else g for k, g in zip(keys, grids, strict=True)]
    points = [*itertools.product(*seen)]
    if mode is not None and not mode.sure and seen != grids:  # another minimum may be the right one
        points += itertools.product(*grids)
    starts = [dict(zip(keys, point, strict=True)) for point in points]
    bends = [k for k, q in zip(keys, parameters, strict=True) if q.hint == "second_harmonic"]
    sign = _sign_of_second_harmonic(observations, *bends[0]) if bends else 0.0
    if sign:
        return [point for point in starts if point[bends[0]] * sign > 0.0]
    if not any(q.is_shape for q in parameters):
        starts.insert(0, {k: q.null_value for k, q in zip(keys, parameters, strict=True)})
    return starts


def _sign_of_second_harmonic(observations: Observations, name: str, parameter: str) -> float:
    """Sign of a parameter that makes the second harmonic, by the phase of the measured one; 0 where no step shows it.

    Plate data hold squares of harmonics, in which both signs look alike. Where a harmonic falls on a forcing tone, its
    gain and phase tell the sign.
    """
    data, plate = observations.plate, observations.steps.plate
    rows = data.rows_of(SECOND)
    omega, tones = plate.omega_radps[data.step[rows]], plate.acceleration_mps2[data.step[rows]]
    at = [np.argmin(np.abs(omega - data.omega_radps[rows, None] / part), axis=1) for part in (2.0, 1.0)]
    first, second = (np.take_along_axis(tones, k[:, None], axis=1)[:, 0] for k in at)
    made = {**effect(name).effect.null_values, parameter: 1.0}
    hook = effect(name).hooks["harmonics"]
    expected = hook(made, data.multiple[rows], data.others[rows], data.shares[rows], np.ones(len(rows)))
    # noise of a harmonic over the first tone is smaller the larger that is
    return float(np.sign(np.sum(data.scale[rows] ** 2 * (np.conj(expected) * share_of_first(first, second, 2)).real)))


def trends_of(free: Sequence[ParameterId]) -> list[Candidate]:
    """Trends of what has been accepted, one by one and of tied parameters together."""
    out = []
    for name, q in free:
        if not q.endswith(TREND) and not parameter_of((name, q)).is_shape and (name, q + TREND) not in free:
            out.append(Candidate((name, trend_name()), ((name, q + TREND),), ({},)))
    for name in dict.fromkeys(n for n, _ in free):
        for group in effect(name).effect.tied.values():
            if all((name, q) in free for q in group):
                out.append(Candidate((name, trend_name()), tuple((name, q + TREND) for q in group), ({},)))
    return out


def distinct_starts(
    starts: Sequence[tuple[float, Point]], free: Sequence[ParameterId], *, with_size: bool = False
) -> list[tuple[float, Point]]:
    """The best start, and the best start whose shape parameters differ from it by more than 30 %.

    With ``with_size``, also the best one away from the null values: where data are squares, they have no slope there.
    """
    shapes = [k for k in free if parameter_of(k).is_shape]
    sizes = [k for k in free if not parameter_of(k).is_shape]
    first = starts[0][1]

    def null(point: Mapping[ParameterId, float]) -> bool:
        return all(point.get(k, 0.0) == null_value_of(k) for k in sizes)

    # a start whose shape lies within 30 % of another's leads to the same fit
    others = [s for s in starts if any(abs(s[1][k] - first[k]) > 0.3 * abs(first[k]) for k in shapes)]
    if with_size and null(first):
        others += [s for s in starts if not null(s[1])]
    return [starts[0], *others[:1]]


def names_in(case: Candidate, fuller: Candidate) -> dict[ParameterId, ParameterId]:
    """What the parameters of a special case are called in the fuller form; empty where it is no special case of it."""
    (name, *more), (own, *others) = case.names, fuller.names
    if more or others or case.free == fuller.free:
        return {}
    table = effect(own).effect.special_cases.get(name, {}) if name != own else {q: q for _, q in case.free}
    found = {(name, q): (own, table[q]) for _, q in case.free if q in table}
    return found if len(found) == len(case.free) and set(found.values()) < set(fuller.free) else {}


def beyond(case: Candidate, fuller: Candidate) -> tuple[ParameterId, ...]:
    """What a fuller form frees beyond a special case; nothing where it is none, or where that has no size."""
    names = names_in(case, fuller)
    extra = tuple(k for k in fuller.free if k not in names.values()) if names else ()
    return extra if any(not parameter_of(k).is_shape for k in extra) else ()


def within(values: Mapping[ParameterId, float], case: Candidate, fuller: Candidate) -> Point:
    """The values of a special case by the names of the fuller form; its further parameters as they are."""
    own = names_in(case, fuller)
    parts = {t: [values[k] for k, v in own.items() if v == t] for t in own.values()}
    return {k: v for k, v in values.items() if k not in own} | {t: float(np.mean(x)) for t, x in parts.items()}
