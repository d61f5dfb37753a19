"""Restitution that scatters from impact to impact, measured from the landings after rebounds.

An impact whose restitution is off by ``d`` moves the next landing by ``d`` times the landing's slope by restitution. Of
a two-sided exponential ``d`` and a normal error of the times the density is known in closed form. Where it fits
landings far better than one excess noise of all of them, the hypotheses are fitted anew with that scatter as a part of
each rebound's uncertainty. The closed loop names it where it then explains the recording. Decision 630.

References
----------
M. Montaine, M. Heckel, C. Kruelle, T. Schwager, T. Poeschel, arXiv:1104.0049 (2011): the scatter of real spheres.
W. J. Reed, "The normal-Laplace distribution and its relatives", in Advances in Distribution Theory (Birkhaeuser, 2006).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import log_ndtr

from analysis.attribution.candidates import Candidate
from analysis.attribution.hypothesis import Hypothesis
from analysis.attribution.selection import Scatter, SelectionResult
from analysis.linear_algebra import pinv
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import T_PEAK, excess_noise
from analysis.residuals.noise.uncertainty import slope_by_rebound, uncertainty_at
from analysis.residuals.prediction_errors import near_grazing
from analysis.thresholds import OUTLIER_FRACTION, Thresholds
from kernels.arrays import Floats
from model.effects.registry import effect

SCATTER = ("restitution_scatter", "sd")
FEWEST_REBOUNDS = 30  # whose landings tell the scatter
LEAST_SD = 1e-5


@dataclass(frozen=True)
class Rebounds:
    """Landings after rebounds: arrays (k,)."""

    missed_s: Floats  # measured minus predicted
    sigma_s: Floats  # uncertainty of that but for a scatter of the restitution
    slope_s: Floats  # by the restitution of the impact before, absolute
    period_s: Floats  # of the forcing

    @classmethod
    def of(cls, x: Hypothesis) -> Rebounds:
        """Those of the steps that the hypothesis was fitted to, grazes left out."""
        model, values, ev = x.model, x.fitted.values, x.model.observations
        u, slope = uncertainty_at(model, values), np.abs(slope_by_rebound(model, values))
        missed = model.residuals(values).landing_s
        rows = ev.scored & ~near_grazing(model, values) & (slope > 0.0) & np.isfinite(missed)
        rows &= x.fitter.train[ev.measured.step]
        sigma = np.sqrt(u.landing_total_s**2 - u.landing_scatter_s**2)
        period = ev.steps.plate.period_s[ev.measured.step]
        return cls(missed[rows], sigma[rows], slope[rows], period[rows])

    def __len__(self) -> int:
        return len(self.missed_s)

    def loss(self, sd: float, scale: float) -> float:
        """Negative log likelihood at a scatter, uncertainties times ``scale``, normalised as in `excess_noise`."""
        x, s = self.missed_s, scale * self.sigma_s
        # a hundredth of the normal error changes nothing, and much less would cancel in doubles
        width = np.maximum(self.slope_s * sd / math.sqrt(2.0), 0.01 * s)
        tails = [sign * x / width + log_ndtr(-sign * x / s - s / width) for sign in (-1.0, 1.0)]
        density = 0.5 * (s / width) ** 2 + np.logaddexp(*tails) - np.log(2.0 * width * T_PEAK)
        outlier = np.log(OUTLIER_FRACTION / (1.0 - OUTLIER_FRACTION) / T_PEAK / self.period_s)
        return -float(np.sum(np.logaddexp(density, outlier)))


def scatter_of(x: Hypothesis) -> Scatter | None:
    """The likeliest scatter of the restitution under a hypothesis; None where too few balls rebound."""
    seen = Rebounds.of(x)
    if len(seen) < FEWEST_REBOUNDS:
        return None
    high = effect(SCATTER[0]).effect.parameter(SCATTER[1]).high

    def loss(y: Floats) -> float:
        return seen.loss(*np.exp(y))

    bounds = [(math.log(LEAST_SD), math.log(high)), (math.log(0.2), math.log(3.0))]
    start = [math.log(0.01), 0.0]
    found = minimize(loss, start, method="Nelder-Mead", bounds=bounds, options={"xatol": 1e-3, "fatol": 1e-3})
    without: Any = minimize_scalar(lambda y: loss(np.array([bounds[0][0], y])), bounds=bounds[1], method="bounded")
    least = min(excess_noise(seen.missed_s, seen.sigma_s, seen.period_s)[1], float(without.fun))
    return Scatter(math.exp(found.x[0]), math.exp(found.x[0]) * _spread(loss, found.x), least - float(found.fun))


def _spread(loss: Callable[[Floats], float], at: Floats) -> float:
    """Standard deviation of the first coordinate by the curvature of the loss at its minimum, (2,)."""
    h = 0.05 * np.eye(2)
    # second differences, times (2 h)^2
    bent = [[loss(at + a + b) - loss(at + a - b) - loss(at - a + b) + loss(at - a - b) for a in h] for b in h]
    return float(math.sqrt(max(pinv(np.array(bent) / 0.01, rcond=1e-9)[0, 0], 0.0)))


def with_scatter(
    found: SelectionResult, limits: Thresholds, select: Callable[[ForwardModel], SelectionResult]
) -> SelectionResult | None:
    """The selection in which the restitution scatters as landings show it; None where they do not.

    Parameters
    ----------
    found
        The selection without a scatter.
    limits
        Thresholds of the verdict.
    select
        The selection under another model.
    """
    model = found.best.model
    scatter = None if SCATTER in model.base else scatter_of(found.best)
    if scatter is None or not scatter.is_clear(limits):
        return None
    for _ in range(2):  # until the scatter stands still
        declared = {**model.declared, SCATTER[0]: {SCATTER[1]: scatter.sd}}
        found = select(ForwardModel(model.observations, declared, like=model))
        used, scatter = scatter, scatter_of(found.best)
        if scatter is None or not scatter.is_clear(limits):
            return None
        if abs(scatter.sd - used.sd) < scatter.sigma:
            break
    cause = Candidate((SCATTER[0],), ())
    best = replace(found.best, candidates=(*found.best.candidates, cause))
    ties = tuple(replace(x, candidates=(*x.candidates, cause)) for x in found.ties[1:])
    said = f"the restitution scatters by {scatter.sd:.2g} from impact to impact: gains {scatter.gain:.0f} nats"
    return replace(found, best=best, ties=(best, *ties), rounds=(*found.rounds, said), scatter=scatter)
