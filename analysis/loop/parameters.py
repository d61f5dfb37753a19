"""Fitted parameters of the best hypothesis, with standard deviations, as numbers and names.

Calibrations are free in every fit, within their stated uncertainty, so that no effect is named for what they explain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from analysis.attribution.hypothesis import Hypothesis
from analysis.loop.result import AddedEffect, Calibration, FittedParameter
from analysis.residuals.values import TREND, ParameterId
from model.effects.registry import effect

Z95 = 1.96  # standard deviations to either end of a 95 % interval


def fitted_parameters(best: Hypothesis) -> tuple[FittedParameter, ...]:
    """Every parameter that the best hypothesis fits: those of the added effects first, in the order added."""
    fitted, values = best.fitted, best.fitted.values

    def one(key: ParameterId, added: bool) -> FittedParameter:
        name, q = key
        plain, sigma = q.removesuffix(TREND), float(fitted.sigma(key))
        if added and plain == q:
            sigma = math.hypot(sigma, effect(name).effect.parameter(plain).ordinary)
        return FittedParameter(name, plain, float(values[key]), sigma, added, q.endswith(TREND))

    return (*(one(k, True) for k in best.free), *(one(k, False) for k in values if k not in best.free))


def fitted_calibrations(best: Hypothesis) -> tuple[Calibration, ...]:
    """Every calibration that the fit left free along with the effects of ``best``, in alphabetical order."""
    fitted = best.fitted
    return tuple(
        Calibration(*key, float(fitted.values[key]), fitted.sigma(key), prior.mean, prior.sigma)
        for key, prior in sorted(fitted.fitter.priors.items())
        if key in fitted.keys and key not in best.free
    )


def added_effects(names: Sequence[str], parameters: Sequence[FittedParameter]) -> tuple[AddedEffect, ...]:
    """Each added effect with its parameters and 95 % intervals; a trend is named ``parameter_drift``.

    Parameters
    ----------
    names
        Effects of the best hypothesis.
    parameters
        All that it fits. A trend is given relative to its parameter's middle, or as it is where that is zero.
    """
    tables: dict[str, dict[str, tuple[float, float, float]]] = {name: {} for name in names}
    middles = {(p.effect, p.parameter): p.value for p in parameters if not p.trend}
    for p in (p for p in parameters if p.added):
        spread = Z95 * p.sigma
        if p.trend:
            middle = middles.get((p.effect, p.parameter), 0.0)
            size = abs(middle) if middle else 1.0
            change = "relative_change" if middle else "change"
            tables.setdefault("parameter_drift", {})[f"{p.effect}.{p.parameter}_{change}"] = (
                p.value / size,
                (p.value - spread) / size,
                (p.value + spread) / size,
            )
            continue
        bounds = effect(p.effect).effect.parameter(p.parameter)
        interval = (p.value, max(p.value - spread, bounds.low), min(p.value + spread, bounds.high))
        tables.setdefault(p.effect, {})[p.parameter] = interval
    return tuple(AddedEffect(name, table) for name, table in tables.items())
