"""The joint verdict from the last pass: parameters over the runs, and each run's goodness of fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from analysis.attribution.candidates import Prior, coordinate_of, null_value_of, parameter_of, value_at
from analysis.joint.alignment import Aligned, width_of
from analysis.joint.constancy import OneRun, constancy, one_run_alone
from analysis.joint.population import Population, each_on_its_own
from analysis.joint.result import OverRuns, Systematic
from analysis.joint.systematics import NAMES, PLACES, UNIT_S
from analysis.residuals.values import ParameterId
from analysis.thresholds import Thresholds
from kernels.arrays import Floats


def parameters_over_runs(
    model: Aligned, found: Population, days: Floats, limits: Thresholds, declared: Mapping[ParameterId, Prior]
) -> tuple[OverRuns, ...]:
    """Every parameter over the runs, named effects first.

    Parameters
    ----------
    model, found
        Of the last pass.
    days
        When each run began, (R,), as `days_since_first` has it.
    declared
        Priors of calibrations before any run.
    """
    columns = model.columns[: model.named - len(PLACES)]
    # Bonferroni's share: so many parameters are tested for constancy
    level = limits.best_of_all_p / max(len(columns), 1)
    every = [_over_runs(model, found, i, key, days, level, declared.get(key)) for i, (key, _) in enumerate(columns)]
    return tuple(sorted(every, key=lambda x: x.kind != "effect"))


def systematics_of(model: Aligned, found: Population) -> tuple[Systematic, ...]:
    """The errors of the contact's edges that all runs share."""
    us = 1e6 * UNIT_S
    return tuple(
        Systematic(name, us * float(found.x[i]), us * found.sigma(i), us * float(model.prior.precision[i] ** -0.5))
        for i, name in enumerate(NAMES, start=model.named - len(PLACES))
    )


def _over_runs(
    model: Aligned, found: Population, place: int, key: ParameterId, days: Floats, level: float, declared: Prior | None
) -> OverRuns:
    """One parameter over the runs."""
    values, sigmas = each_on_its_own(model.runs, found, place)
    own = place < len(model.width)
    if own:
        # a calibration is seen where a run's own sigma is below its prior's: else the run only repeats the profile
        sigmas = np.where(sigmas < model.width[place], sigmas, np.inf)
    test = constancy(values, sigmas, days)
    effect = not own or model.prior.precision[place] == 0.0
    x, sigma = float(found.x[place]), found.sigma(place)
    spread = float(found.spread[place]) if own else test.spread
    slope = float(np.sign(test.slope)) * _in_unit(key, x, abs(test.slope))
    in_units = replace(
        test, spread=_in_unit(key, x, test.spread), slope=slope, slope_sigma=_in_unit(key, x, test.slope_sigma)
    )
    inside = [(value_at(key, float(v)), _in_unit(key, float(v), float(s))) for v, s in zip(values, sigmas, strict=True)]
    return OverRuns(
        *key, parameter_of(key).unit, "effect" if effect else "calibration", value_at(key, x), _in_unit(key, x, sigma),
        _in_unit(key, x, spread), tuple(v for v, _ in inside), tuple(s for _, s in inside),
        in_units, test.differs(level), _one_run(key, values, sigmas, declared) if effect else None,
    )  # fmt: skip


def _one_run(key: ParameterId, values: Floats, sigmas: Floats, declared: Prior | None) -> OneRun | None:
    """The only run that shows a named effect, its others in the parameter's unit."""
    stated = Prior(null_value_of(key), 0.0) if declared is None else declared
    found = one_run_alone(values, sigmas, coordinate_of(key, stated.mean), width_of(key, stated.sigma))
    if found is None:
        return None
    sigma = _in_unit(key, found.others, found.others_sigma)
    return replace(found, others=value_at(key, found.others), others_sigma=sigma)


def _in_unit(key: ParameterId, x: float, width: float) -> float:
    """A width about a coordinate, in the parameter's unit; infinite where it is."""
    if not np.isfinite(width):
        return float("inf")
    if parameter_of(key).power == 1.0:
        return width * parameter_of(key).scale
    # a coordinate that is a root of the value has no constant unit: half the interval's length
    return 0.5 * (value_at(key, x + width) - value_at(key, x - width))


def days_since_first(started: Sequence[str]) -> tuple[Floats, bool]:
    """Days from the first run to each start (ISO 8601), (R,), and whether they are known; else the runs' numbers."""
    try:
        starts = [datetime.fromisoformat(x) for x in started]
        seconds = np.array([(x - min(starts)).total_seconds() for x in starts])
    except (ValueError, TypeError):
        return np.arange(len(started), dtype=np.float64), False
    # two runs that began at one instant have wrong clocks: a trend with the date would mean nothing
    if len(set(seconds.tolist())) < len(seconds):
        return np.arange(len(started), dtype=np.float64), False
    return seconds / 86400.0, True
