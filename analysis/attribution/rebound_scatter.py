"""Restitution that scatters from impact to impact, measured from the landings after rebounds.

An impact whose restitution is off by ``d`` moves the next landing by ``d`` times the landing's slope by restitution. Of
a two-sided exponential ``d`` and a normal error of the times the density is known in closed form. How much of the
jitter that repeated cycles show is the contact's, and not the scattered motion's, is fitted, too. Where the scatter
fits landings far better than one excess noise of all of them, the hypotheses are fitted anew with it as a part of each
rebound's uncertainty. The closed loop names it where it then explains the recording. Decisions 630, 757.

The plate's tones err alike for all flights of a step, and in a cycle move all of its landings by the same. That is no
scatter, which differs from impact to impact: a scatter must gain over such errors as well. Decision 751.

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
from scipy.optimize import minimize
from scipy.special import log_ndtr

from analysis.attribution.candidates import Candidate
from analysis.attribution.hypothesis import Hypothesis, Scatter
from analysis.attribution.selection import SelectionResult
from analysis.linear_algebra import pinv
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import T_PEAK, excess_noise
from analysis.residuals.noise.uncertainty import REBOUND_STEP, slope_by_rebound, uncertainty_at
from analysis.residuals.noise.whitening import StepBlocks
from analysis.residuals.prediction_errors import near_grazing
from analysis.residuals.values import Values
from analysis.thresholds import LEAST_EXCESS_S, OUTLIER_FRACTION, SHARED_S, Thresholds
from kernels.arrays import Floats, Integers
from model.effects.registry import effect, offsets

SCATTER = ("restitution_scatter", "sd")
FEWEST_REBOUNDS = 30  # whose landings tell the scatter
LEAST_SD = 1e-5


@dataclass(frozen=True)
class Rebounds:
    """Landings after rebounds, in the order of their steps: arrays (k,)."""

    missed_s: Floats  # measured minus predicted
    own_s: Floats  # uncertainty of that which no other landing shares, but for scatter and the contact's jitter
    shared_s: Floats  # one sigma of each error that those of a step share, (k, q)
    slope_s: Floats  # by the restitution of the impact before, absolute
    period_s: Floats  # of the forcing
    step: Integers
    jitter_s: Floats | float = 0.0  # what jitter adds, if the contact's is all that repeated cycles show

    @classmethod
    def of(cls, x: Hypothesis) -> Rebounds:
        """Those of the steps that the hypothesis was fitted to, grazes left out."""
        model, values, ev = x.model, x.fitted.values, x.model.observations
        # landings of cycles that repeat scatter by the contact's jitter, and by what the restitution does
        variance = ev.landing_sigma_s**2 - ev.circuit.scatters[1].raised(np.zeros(1)) ** 2
        firm = replace(ev, landing_sigma_s=np.sqrt(np.maximum(variance, 1e-4 * ev.landing_sigma_s**2)))
        u = uncertainty_at(model, values)
        sure = uncertainty_at(ForwardModel(firm, model.declared, like=model), values, u.changes)
        own, shared = np.sqrt(sure.landing_sigma_s**2 - sure.landing_scatter_s**2), sure.landing_by_tone
        jitter = np.sqrt(np.maximum(u.landing_total_s**2 - sure.landing_total_s**2, 0.0))
        missed, slope = _explained(model, values, np.hypot(own, np.linalg.norm(shared, axis=1)))
        rows = ev.scored & ~near_grazing(model, values) & (slope > 0.0) & np.isfinite(missed)
        rows &= x.fitter.train[ev.measured.step]
        step = ev.measured.step[rows]
        period_s = ev.steps.plate.period_s[step]
        return cls(missed[rows], own[rows], shared[rows], slope[rows], period_s, step, jitter[rows])

    def __len__(self) -> int:
        return len(self.missed_s)

    @property
    def sigma_s(self) -> Floats:
        """Uncertainty but for a scatter of the restitution and the contact's jitter."""
        return np.asarray(np.hypot(self.own_s, np.linalg.norm(self.shared_s, axis=1)))

    def loss(self, sd: float, scale: float, part: float = 0.0, lost: float = OUTLIER_FRACTION) -> float:
        """Negative log likelihood at a scatter, uncertainties times ``scale``, normalised as in `excess_noise`.

        So large a ``part`` of the jitter is the contact's, and such a part of landings ``lost`` is something else.
        """
        x, s = self.missed_s, scale * np.hypot(self.sigma_s, part * self.jitter_s)
        # a hundredth of the normal error changes nothing, and much less would cancel in doubles
        width = np.maximum(self.slope_s * sd / math.sqrt(2.0), 0.01 * s)
        tails = [sign * x / width + log_ndtr(-sign * x / s - s / width) for sign in (-1.0, 1.0)]
        density = 0.5 * (s / width) ** 2 + np.logaddexp(*tails) - np.log(2.0 * width * T_PEAK)
        # more than are lost would take the exponential's own tails from it
        outlier = np.log(lost / (1.0 - OUTLIER_FRACTION) / T_PEAK / self.period_s)
        return -float(np.sum(np.logaddexp(density + math.log((1.0 - lost) / (1.0 - OUTLIER_FRACTION)), outlier)))

    def shared_loss(self, sd: float, scale: float, part: float = 0.0) -> float:
        """The same by Student's t, where landings of a step share errors as `Whitener` has them."""
        shared = np.column_stack([self.shared_s, np.full(len(self), SHARED_S)])
        bare = (scale * self.own_s) ** 2 + (scale * part * self.jitter_s) ** 2 + (self.slope_s * sd) ** 2
        own = np.sqrt(bare + 0.01 * np.sum(shared**2, axis=1))
        bounds = np.flatnonzero(np.diff(self.step, prepend=-1, append=-1)).astype(np.int64)
        blocks = StepBlocks(self.missed_s, own, shared, np.zeros(len(self), np.bool_), self.period_s, bounds)
        return blocks.loss((LEAST_EXCESS_S, LEAST_EXCESS_S))


def _explained(model: ForwardModel, values: Values, sigma_s: Floats) -> tuple[Floats, Floats]:
    """Landings' misses (n,), and their slope by the restitution, about the restitution that explains each.

    Landings bend with the restitution, up to a graze; the tangent at the mean would show a scatter of another size.
    """
    missed, off = model.residuals(values).landing_s, np.zeros(len(sigma_s))
    slope, moved = slope_by_rebound(model, values), np.zeros(len(sigma_s))
    base, high = model.predicted(values), effect(SCATTER[0]).effect.parameter(SCATTER[1]).high
    rows = np.broadcast_to(own := model.rows(values), (len(off), own.shape[-1]))

    def moved_by(restitution: Floats) -> Floats:
        other = np.array(rows)
        other[:, offsets()["restitution", "e0"]] += restitution
        return np.asarray(model.predict(values, rows=other, near=base).landing_s - base.landing_s)

    for _ in range(4 if slope.any() else 0):
        # what noise may have made is left to it
        far = np.sign(missed) * np.maximum(np.abs(missed) - sigma_s, 0.0) - moved
        step = np.divide(far, slope, out=np.zeros_like(slope), where=slope != 0.0)
        to = np.clip(off + np.nan_to_num(step), -high, high)
        there = moved_by(to)
        bent = (moved_by(to + REBOUND_STEP) - there) / REBOUND_STEP
        nearer = (np.abs(far + moved - there) < np.abs(far)) & (slope * bent > 0.0)
        off, slope, moved = (np.where(nearer, y, z) for y, z in ((to, off), (bent, slope), (there, moved)))
    return missed - moved + slope * off, np.abs(slope)


def scatter_of(x: Hypothesis) -> Scatter | None:
    """The likeliest scatter of the restitution under a hypothesis; None where too few balls rebound."""
    seen = Rebounds.of(x)
    if len(seen) < FEWEST_REBOUNDS:
        return None
    high = effect(SCATTER[0]).effect.parameter(SCATTER[1]).high

    of_rest = [(math.log(0.2), math.log(3.0)), (math.log(1e-3), 0.0), (math.log(1e-4), math.log(OUTLIER_FRACTION))]
    bounds = [(math.log(LEAST_SD), math.log(high)), *of_rest]

    def loss(y: Floats) -> float:
        return seen.loss(*np.exp(y))

    def least(of: Callable[..., float], start: tuple[float, ...], sd: tuple[float, ...] = ()) -> Any:
        """The least loss of all, or of those at a scatter."""

        def own(y: Any) -> Any:
            return of(*np.exp(np.append(sd, y)))

        how: Any = {"method": "Nelder-Mead", "options": {"xatol": 1e-3, "fatol": 1e-3}}
        return minimize(own, np.array(start), bounds=bounds[len(sd) : len(sd) + len(start)], **how)

    starts, none = [(0.0, part, -6.0) for part in (-3.0, -0.5)], (bounds[0][0],)
    found = min((least(seen.loss, (math.log(0.01), *start)) for start in starts), key=lambda fit: float(fit.fun))
    rival = min(
        *(float(least(seen.loss, start, none).fun) for start in starts),
        *(float(least(seen.shared_loss, start[:2], none).fun) for start in starts),
        *(
            excess_noise(seen.missed_s, s, seen.period_s)[1]
            for s in (seen.sigma_s, np.hypot(seen.sigma_s, seen.jitter_s))
        ),
    )
    fit = min(float(found.fun), float(least(seen.shared_loss, (*found.x[:3],)).fun))
    at, h = found.x, 0.05 * np.eye(len(found.x))
    # curvature of the loss at its minimum, by second differences, times (2 h)^2
    bent = [[loss(at + a + b) - loss(at + a - b) - loss(at - a + b) + loss(at - a - b) for a in h] for b in h]
    spread = math.sqrt(max(pinv(np.array(bent) / 0.01, rcond=1e-9)[0, 0], 0.0))
    return Scatter(math.exp(at[0]), math.exp(at[0]) * float(spread), rival - fit)


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
    model, used_sd, turns = found.best.model, math.inf, 2
    if SCATTER in model.base:
        return None
    while True:  # until the scatter stands still
        scatter = scatter_of(found.best)
        if scatter is None or not scatter.is_clear(limits):
            return None
        if not turns or abs(scatter.sd - used_sd) < scatter.sigma:
            break
        turns -= 1
        declared, used_sd = {**model.declared, SCATTER[0]: {SCATTER[1]: scatter.sd}}, scatter.sd
        found = select(ForwardModel(model.observations, declared, like=model))
    cause = Candidate((SCATTER[0],), ())
    best = replace(found.best, candidates=(*found.best.candidates, cause))
    ties = tuple(replace(x, candidates=(*x.candidates, cause)) for x in found.ties[1:])
    said = f"the restitution scatters by {scatter.sd:.2g} from impact to impact: gains {scatter.gain:.0f} nats"
    return replace(found, best=best, ties=(best, *ties), rounds=(*found.rounds, said), scatter=scatter)
