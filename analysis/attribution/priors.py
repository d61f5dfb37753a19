"""Priors of calibrations, nuisances and declared effects, and the parameters behind their keys."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass

from analysis.residuals.values import TREND, ParameterId
from daq.setup.setup import Setup
from model.effects.registry import Parameter, effect, registry


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
