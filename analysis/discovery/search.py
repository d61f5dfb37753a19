"""Search for one smooth term in addition to named effects: all terms are screened, the best are fitted jointly.

A term with one value for each flight is screened on a table of predictions at constant values: a flight's residual
depends only on its own value, so that every covariate can use the same table. A curve is judged on steps that it was
not fitted to, with everything else refitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from analysis.attribution.candidates import Candidate
from analysis.attribution.coarse_search import subsample
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.computing import THREADS
from analysis.discovery.fit import Problem, StackedResiduals, descend, fit_in_flight, jacobian_of, normal_equations
from analysis.discovery.terms import (
    EVENT_GRIDS,
    IN_FLIGHT,
    AugmentedModel,
    Curve,
    Term,
    basis_of,
    event_term,
    event_terms,
    hat_functions,
    knots_of,
    ranges_of,
)
from analysis.linear_algebra import pinv
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import log_odds, robust_loss
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import ParameterId, Values
from analysis.statistics import Z95
from kernels.arrays import Bools, Floats
from model.effects.registry import effect

FINALISTS = 5  # screened terms that are fitted jointly, at most
SCREENING_TAILS = (0.9, 0.7, 0.5, 0.5, 0.5)  # as `TAILS`, for terms within the flight
NEAREST_COVARIATE = {  # of a whole flight, for a quantity that varies within it
    "since_impact_s": "dwell_s",
    "impact_mps": "previous_impact_mps",
}
TAILS = (0.9, 0.8, 0.65)  # quantiles of the residuals that set the robust width in the first passes
SHARP = (0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)  # the same in the last passes: the median
ROUGHNESS = np.geomspace(0.01, 0.6, 8)  # candidates of the smoothing parameter
START_SIZES: dict[str, Floats] = {
    "force": np.concatenate([np.geomspace(0.05, 80.0, 7), -np.geomspace(0.05, 80.0, 7)]),
    "friction": np.geomspace(0.005, 2.0, 6),
    "restitution": np.geomspace(0.03, 0.9, 6),
}


@dataclass(frozen=True)
class ScreenedTerm:
    """A curve and its loss on the steps of the fit."""

    curve: Curve
    loss: float


def residual_table(model: ForwardModel, values: Values, stack: StackedResiduals, name: str) -> Floats:
    """Residuals (g, k) at each constant value of ``EVENT_GRIDS[name]``."""
    n = len(model.observations)
    one, term = np.ones((n, 1)), event_term(name, "")
    still = np.zeros(n)
    rows = [
        stack.residuals(AugmentedModel(model, [Curve(term, np.zeros(1), np.array([x]), one)], still), values)
        for x in EVENT_GRIDS[name]
    ]
    return np.array(rows)


def best_constant(table: Floats, stack: StackedResiduals, name: str) -> tuple[float, float]:
    """Best constant value and its loss."""
    losses = [stack.loss(r) for r in table]
    best = int(np.argmin(losses))
    return float(EVENT_GRIDS[name][best]), losses[best]


def screen_covariate(table: Floats, stack: StackedResiduals, term: Term, x: Floats, knots: Floats) -> ScreenedTerm:
    """Spline of one covariate on the table: the best value near each knot, then Gauss-Newton.

    ``table`` and ``stack`` are of `residual_table`; ``x`` are the covariate's values (n,), and at ``knots`` the spline
    bends.
    """
    grid = EVENT_GRIDS[term.name]
    basis = basis_of(x, knots)
    near = hat_functions(x, knots)[stack.event]
    values = np.full(len(knots), best_constant(table, stack, term.name)[0])
    weights = near * stack.train[:, None]
    for tail in TAILS:
        r, _ = _interpolated(table, grid, near @ values)
        width = stack.widths(r, tail)
        # near each knot the constant value that fits the events there best: a start for every value, without a slope
        by_value = robust_loss(table / width, log_odds(width, stack.period_s)) @ weights
        values = grid[np.argmin(by_value, axis=0)]
    rows = basis[stack.event]
    problem = Problem[Curve](
        lambda c: _interpolated(table, grid, c.table[stack.event])[0],
        lambda c, _: _interpolated(table, grid, c.table[stack.event])[1][:, None] * rows,
        Curve.stepped,
        Curve.penalty,
    )
    curve, r = descend(problem, Curve(term, knots, values, basis), stack, (*TAILS[1:], *SHARP))
    return ScreenedTerm(curve, stack.loss(r))


def _interpolated(table: Floats, grid: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Residuals at each event's own value, linearly interpolated, and their slope."""
    i = np.clip(np.searchsorted(grid, value) - 1, 0, len(grid) - 2)
    k = np.arange(table.shape[1])
    slope = (table[i + 1, k] - table[i, k]) / (grid[i + 1] - grid[i])
    return table[i, k] + slope * (value - grid[i]), slope


def best_start(model: ForwardModel, values: Values, stack: StackedResiduals, curve: Curve, dwell_s: Floats) -> Curve:
    """``curve`` or a plain shape of some size in its place, whichever predicts best.

    A strong term sends flights to other landings than a weak one, so that a descent from zero ends in a local minimum.
    The shapes are constant, proportional to the covariate, to its square, and falling linearly to zero.
    """
    x = curve.knots / float(np.max(np.abs(curve.knots)))
    falls = (curve.knots[-1] - curve.knots) / (curve.knots[-1] - curve.knots[0])
    unit = model.gravity if curve.term.against_motion else 1.0
    sizes = unit * START_SIZES[curve.term.name]
    shapes = (np.ones_like(x), x, x * np.abs(x), falls)
    starts = [curve, *(curve.moved(size * shape) for shape in shapes for size in sizes)]
    losses = [stack.loss(stack.residuals(AugmentedModel(model, [c], dwell_s), values)) for c in starts]
    return starts[int(np.argmin(losses))]


@dataclass(frozen=True)
class RefinedTerm:
    """A term fitted jointly with everything else."""

    curve: Curve  # the term
    covariance: Floats  # of its values, from the noise of events
    folds: Floats  # its values without some of the steps, (f, k)
    # root mean square of the landings over their uncertainty, each step's with the curve that the others give
    scatter: float
    model: AugmentedModel  # with the term
    explanation: Hypothesis  # the fit there, and its held-out losses

    @property
    def per_step(self) -> Floats:
        """Held-out loss by step, (m,)."""
        return self.explanation.per_step

    @property
    def band(self) -> Floats:
        """Half the width of the pointwise 95 % band at the curve's points.

        From the noise of events, or from a delete-a-group jackknife over steps (Efron and Tibshirani 1993) where wider.
        """
        basis = basis_of(self.curve.points, self.curve.knots)
        noise = np.maximum(np.sum((basis @ self.covariance) * basis, axis=1), 0.0)
        # jackknife: (f - 1) / f times the sum of the squared deviations of f curves
        steps = (len(self.folds) - 1) * np.var(self.folds @ basis.T, axis=0)
        return np.asarray(Z95 * np.sqrt(np.maximum(noise, steps)))

    @property
    def held_out(self) -> float:
        """Held-out loss of all steps of the fit."""
        return float(self.per_step[self.explanation.fitter.train].sum())


class TermSearch:
    """Search for a term in addition to the named effects ``named``."""

    def __init__(
        self,
        model: ForwardModel,
        fitter: Fitter,
        explanation: Hypothesis,
        named: tuple[Candidate, ...],
        tables: Mapping[str, Floats],
        *,
        in_place: bool = False,
    ) -> None:
        self.model, self.fitter, self.train, self.tables, self.named = model, fitter, fitter.train, tables, named
        self.free: tuple[ParameterId, ...] = tuple(k for c in named for k in c.free)
        # calibrations may be biased by the missing term: all but the contact's own start from their priors
        self.values = {
            k: v for k, v in explanation.fitted.values.items() if k in self.free or effect(k[0]).effect.nuisance
        }
        self.dwell, self.near = tables["dwell_s"], explanation.whitener
        self.rival = explanation.fitted.values if in_place else None  # of effects that a term would have to replace

    def screen(self) -> list[ScreenedTerm]:
        """All terms on all covariates; those near the best.

        Where openings depend on the contact's gap, which a wrong model bends, terms are screened without them as well.
        """
        both = StackedResiduals.of(self.model, self.values, self.train)
        constant = {name: residual_table(self.model, self.values, both, name) for name in EVENT_GRIDS}
        found = self._screened(both, constant)
        if self._gap_matters(both):
            seen = {(t.curve.term.name, t.curve.term.of) for t in found[:FINALISTS]}
            again = self._screened(both.landings(), {name: table[:, ~both.first] for name, table in constant.items()})
            found = found[:FINALISTS] + [t for t in again if (t.curve.term.name, t.curve.term.of) not in seen]
        return found

    def _gap_matters(self, stack: StackedResiduals) -> bool:
        """Whether the contact's own imperfections move openings by more than these are known."""
        rest = {k: v for k, v in self.values.items() if not effect(k[0]).effect.nuisance}
        r = stack.residuals(self.model, self.values) - stack.residuals(self.model, rest)
        # a gap that moves the openings by more than their uncertainty would hide a term: it is also screened on
        # landings only
        return bool(stack.first.any() and np.median(np.abs(r / stack.sigma_s)[stack.first]) > 1.0)

    def _screened(self, stack: StackedResiduals, constant: Mapping[str, Floats]) -> list[ScreenedTerm]:
        """Terms near the best, by the residuals of ``stack`` at each ``constant`` value of a term; see `screen`."""
        ahead = stack.loss(stack.residuals(self.model, self.values))
        judged = self.model.observations.scored
        tried: list[ScreenedTerm] = []
        constants: dict[str, float] = {}
        known: dict[tuple[str, str], Curve] = {}
        for name, table in constant.items():
            constants[name] = best_constant(table, stack, name)[0]
            for term in event_terms(name):
                x = self.tables[term.of]
                knots = knots_of(x[judged])
                if not len(knots):  # known of no flight
                    continue
                tried.append(screen_covariate(table, stack, term, x, knots))
                known[name, term.of] = tried[-1].curve
        ranges = ranges_of(self.tables, judged)
        few = []  # models of about so many events: 120 choose the starting shape, 200 are fitted, to order the terms
        for model in (subsample(self.model, self.train, most) for most in (120, 200)):
            seen = StackedResiduals.of(model, self.values, self.train, self.near.changes)
            few.append((model, self.values, seen if stack.first.any() else seen.landings()))

        def within_flight(term: Term) -> ScreenedTerm:  # begun from the term with one value for each flight
            curve = Curve.even(term, ranges[term.of])
            start = known.get((term.name, NEAREST_COVARIATE.get(term.of, "")))
            if term.name != "force":
                # at its bound of 0 such a term has no slope: it begins at 0.01
                constant = np.full_like(curve.values, max(constants[term.name], 0.01))
                values = constant if start is None else start.at(curve.knots)
                curve = curve.moved(values * (self.model.gravity if term.against_motion else 1.0))
            curve = best_start(*few[0], curve, self.dwell)
            curve = fit_in_flight(*few[1], curve, self.dwell, SCREENING_TAILS)
            augmented = AugmentedModel(self.model, [curve], self.dwell)
            return ScreenedTerm(curve, stack.loss(stack.residuals(augmented, self.values)))

        with ThreadPoolExecutor(THREADS) as pool:
            tried += pool.map(within_flight, [t for t in IN_FLIGHT if ranges[t.of][0] < ranges[t.of][1]])
        tried.sort(key=lambda t: t.loss)
        rival = math.inf if self.rival is None else stack.loss(stack.residuals(self.model, self.rival))
        best = min(tried[0].loss, rival)
        # terms that lose at most 40 % of the best screened gain are fitted in full
        return [t for t in tried if t.loss < best + 0.4 * (ahead - best)][:FINALISTS]

    def refine(self, curve: Curve) -> RefinedTerm:
        """Curve and everything else fitted in turn; roughness and score from steps that the curve was not fitted to."""
        values, slopes = dict(self.values), dict[ParameterId, Floats]()
        passes, near = SHARP if not curve.term.columns else SHARP[:2], self.near
        for first in (True, False):
            model = AugmentedModel(self.model, [curve], self.dwell)
            stack = StackedResiduals.of(model, values, self.train, near.changes)
            if first and curve.term.name != "threshold" and self._gap_matters(stack):
                stack = stack.landings()
            tails = (TAILS[-1], *passes) if first else passes
            curve = fit_in_flight(self.model, values, stack, curve, self.dwell, tails)
            if first:
                curve = self._cross_validated_roughness(curve, values, stack)
            augmented = AugmentedModel(self.model, [curve], self.dwell)
            twin = Fitter(augmented, self.fitter.priors, self.train)
            near = Whitener.of(augmented, values, near)
            fitted = twin.fit(near, self.free, values, slopes)
            values, slopes = fitted.values, fitted.slopes
        near = Whitener.of(augmented, values, near)
        stack = StackedResiduals.of(augmented, values, self.train, near.changes)
        r = stack.residuals(augmented, values)
        jacobian = jacobian_of(self.model, values, stack, curve, self.dwell, r)

        def after(step: Floats) -> Floats:
            return stack.residuals(AugmentedModel(self.model, [curve.stepped(step)], self.dwell), values)

        held, moves = stack.held_out(r, jacobian, after, curve.penalty())
        curves = np.array([curve.stepped(step).values for step in moves])
        losses = {"events": stack.by_step(held), "plate": plate_loss(augmented, values)}
        explanation = Hypothesis(self.named, fitted, near, losses)
        normal, _ = normal_equations(stack, r, jacobian, penalty=curve.penalty())
        covariance, scatter = np.asarray(pinv(normal, rcond=1e-14), np.float64), stack.scatter(held)
        return RefinedTerm(curve, covariance, curves, scatter, augmented, explanation)

    def _cross_validated_roughness(self, curve: Curve, values: Values, stack: StackedResiduals) -> Curve:
        """The curve with the smoothing parameter of least loss in 8-fold cross-validation over steps (linearised)."""
        r = stack.residuals(AugmentedModel(self.model, [curve], self.dwell), values)
        jacobian = jacobian_of(self.model, values, stack, curve, self.dwell, r)

        def unseen(roughness: float) -> float:
            penalty = replace(curve, roughness=roughness).penalty()
            held, _ = stack.held_out(r, jacobian, lambda step: r + jacobian @ step, penalty)
            return float(stack.by_step(held)[self.train].sum())

        return replace(curve, roughness=min(ROUGHNESS, key=unseen))


def plate_loss(model: ForwardModel, values: Values) -> Floats:
    """Loss of the plate data by step."""
    data = model.observations.plate
    loss = robust_loss(model.residuals(values).plate / data.sigma)
    return np.asarray(np.bincount(data.step, loss, minlength=len(model.observations.steps)), dtype=np.float64)


def named_loss(model: ForwardModel, explanation: Hypothesis, train: Bools) -> Floats:
    """Loss of a named hypothesis by step, computed as in `TermSearch.refine`."""
    values = explanation.fitted.values
    stack = StackedResiduals.of(model, values, train)
    return np.asarray(stack.by_step(stack.residuals(model, values)) + plate_loss(model, values))
