"""The search for one smooth term beside named effects: first looks at all of them, then joint fits of the best.

The rule kept here: a curve is judged on steps that it did not see, everything else being fitted again beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.attribution.candidates import Candidate
from analysis.attribution.coarse_search import subsample
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.discovery.penalised_fit import (
    SHARP,
    TAILS,
    ScreenedTerm,
    StackedResiduals,
    best_start,
    constant_of,
    covariance_of,
    newton_step,
    slopes_of,
    table_of,
    try_covariate,
    try_in_flight,
)
from analysis.discovery.spline_basis import basis_of, knots_of
from analysis.discovery.terms import EVENT_GRIDS, IN_FLIGHT, AugmentedModel, Curve, Term, event_terms, ranges_of
from analysis.parallel import THREADS
from analysis.residuals.forward_model import ForwardModel, ParameterId, Values
from analysis.residuals.noise_model import robust_loss
from analysis.residuals.whitening import Whitener
from model.effects.registry import effect

Array = NDArray[np.float64]

FINALISTS = 5
FIRST_TAILS = (
    0.9,
    0.7,
    0.5,
    0.5,
    0.5,
)  # of the first looks within the flight: see `analysis.discovery.penalised_fit.TAILS`
NEAR = 0.4  # of the best first look's gain: who is nearer is looked at again
LIKE = {"since_impact_s": "dwell_s", "impact_mps": "previous_impact_mps"}  # nearest covariate of a whole flight
SOME = 0.01  # from nothing at all no step leads down
GAP_SIGMAS = 1.0  # by which openings move for the contact's gap to be doubted
ROUGHNESS = np.geomspace(0.01, 0.6, 8)  # of curves, to choose from
CURVE_FOLDS = 8  # many, so that a curve is hardly less supported without one
START_EVENTS, FIRST_EVENTS = 120, 200  # that tell which plain shape to begin with, and lead to a first look


@dataclass(frozen=True)
class RefinedTerm:
    """A curve in its world, with the fit of everything else there and the held-out losses.

    ``covariance`` is that of its values from the noise of events; ``folds`` (f, k), its values without some steps.
    """

    curve: Curve
    covariance: Array
    folds: Array
    world: AugmentedModel
    explanation: Hypothesis

    @property
    def per_step(self) -> Array:
        return self.explanation.per_step

    @property
    def band(self) -> Array:
        """Half the width of the pointwise 95 % band at the curve's points.

        From the noise of events or, where that is more, from the differences between steps (delete-a-group jackknife).
        """
        basis = basis_of(self.curve.points, self.curve.knots)
        noise = np.maximum(np.sum((basis @ self.covariance) * basis, axis=1), 0.0)
        steps = (len(self.folds) - 1) * np.var(self.folds @ basis.T, axis=0)
        return np.asarray(1.96 * np.sqrt(np.maximum(noise, steps)))

    @property
    def held_out(self) -> float:
        return float(self.per_step[self.explanation.fitted.fitter.train].sum())


class TermSearch:
    """The search for a term beside the named effects ``kept``."""

    def __init__(
        self,
        world: ForwardModel,
        fitter: Fitter,
        explanation: Hypothesis,
        kept: tuple[Candidate, ...],
        train: NDArray[np.bool_],
        tables: Mapping[str, Array],
    ) -> None:
        self.world, self.fitter, self.train, self.tables, self.kept = world, fitter, train, tables, kept
        self.free: tuple[ParameterId, ...] = tuple(k for c in kept for k in c.free)
        # calibrations may have been bent to make up for what is missing: all but the contact's own begin anew
        self.values = {
            k: v for k, v in explanation.fitted.values.items() if k in self.free or effect(k[0]).effect.nuisance
        }
        self.dwell = tables["dwell_s"]

    def first_looks(self) -> list[ScreenedTerm]:
        """All terms on all covariates; those near the best.

        Where openings hang on the contact's gap they are looked at with and without: a wrong model bends the gap.
        """
        both = StackedResiduals.of(self.world, self.values, self.train)
        found = self._looked(both)
        if self._gap_shows(both):
            seen = {(t.curve.term.name, t.curve.term.of) for t in found[:FINALISTS]}
            again = self._looked(both.landings())
            found = found[:FINALISTS] + [t for t in again if (t.curve.term.name, t.curve.term.of) not in seen]
        return found

    def _gap_shows(self, stack: StackedResiduals) -> bool:
        """Whether the contact's own imperfections move openings by more than these are known."""
        rest = {k: v for k, v in self.values.items() if not effect(k[0]).effect.nuisance}
        r = stack.residuals(self.world, self.values) - stack.residuals(self.world, rest)
        return bool(stack.first.any() and np.median(np.abs(r / stack.sigma_s)[stack.first]) > GAP_SIGMAS)

    def _looked(self, stack: StackedResiduals) -> list[ScreenedTerm]:
        ahead = stack.loss(stack.residuals(self.world, self.values))
        judged = self.world.evidence.scored
        tried: list[ScreenedTerm] = []
        constants: dict[str, float] = {}
        known: dict[tuple[str, str], Curve] = {}
        for name in EVENT_GRIDS:
            table = table_of(self.world, self.values, stack, name)
            constants[name] = constant_of(table, stack, name)[0]
            for term in event_terms(name):
                x = self.tables[term.of]
                tried.append(try_covariate(table, stack, term, x, knots_of(x[judged])))
                known[name, term.of] = tried[-1].curve
        ranges = ranges_of(self.tables, judged)
        with ThreadPoolExecutor(THREADS) as pool:
            tried += pool.map(lambda t: self._within(stack, t, ranges[t.of], constants[t.name], known), IN_FLIGHT)
        tried.sort(key=lambda t: t.loss)
        return [t for t in tried if t.loss < tried[0].loss + NEAR * (ahead - tried[0].loss)][:FINALISTS]

    def _within(
        self,
        stack: StackedResiduals,
        term: Term,
        span: tuple[float, float],
        constant: float,
        known: Mapping[tuple[str, str], Curve],
    ) -> ScreenedTerm:
        """A term within the flight, begun at what a value for each flight has shown."""
        curve = Curve.even(term, span)
        start = known.get((term.name, LIKE.get(term.of, "")))
        if term.name != "force":
            values = np.full_like(curve.values, max(constant, SOME)) if start is None else start.at(curve.knots)
            curve = curve.moved(values * (self.world.gravity if term.against_motion else 1.0))
        curve = best_start(*self._few(stack, START_EVENTS), curve, self.dwell)
        curve = try_in_flight(*self._few(stack, FIRST_EVENTS), curve, self.dwell, FIRST_TAILS).curve
        return ScreenedTerm(
            curve, stack.loss(stack.residuals(AugmentedModel(self.world, [curve], self.dwell), self.values))
        )

    def _few(self, stack: StackedResiduals, most: int) -> tuple[ForwardModel, Values, StackedResiduals]:
        """World, values and stack with so many events: openings and landings, or landings alone where ``stack`` is."""
        few = subsample(self.world, self.train, most)
        seen = StackedResiduals.of(few, self.values, self.train)
        return few, self.values, seen if stack.first.any() else seen.landings()

    def polished(self, curve: Curve) -> RefinedTerm:
        """Curve and everything else fitted in turn; how stiff, and how good, is judged on steps unseen by the curve."""
        values, slopes = dict(self.values), dict[ParameterId, Array]()
        passes = SHARP if not curve.term.columns else SHARP[:2]
        for first in (True, False):
            stack = StackedResiduals.of(AugmentedModel(self.world, [curve], self.dwell), values, self.train)
            if first and curve.term.name != "threshold" and self._gap_shows(stack):
                stack = stack.landings()
            tails = (TAILS[-1], *passes) if first else passes
            curve = try_in_flight(self.world, values, stack, curve, self.dwell, tails).curve
            if first:
                curve = self._as_stiff_as_needed(curve, values, stack)
            spliced = AugmentedModel(self.world, [curve], self.dwell)
            twin = Fitter(spliced, self.fitter.priors, self.train)
            fitted = twin.fit(Whitener.of(spliced, values), self.free, values, slopes)
            values, slopes = fitted.values, fitted.slopes
        stack = StackedResiduals.of(spliced, values, self.train)
        r = stack.residuals(spliced, values)
        jacobian = slopes_of(self.world, values, stack, curve, self.dwell, r)
        opening_s, landing_s, folds = self._held_out(curve, values, stack, r, jacobian)
        held = stack.cut(opening_s, landing_s)
        losses = {"events": self._by_step(stack, held), "plate": plate_loss(spliced, values)}
        explanation = Hypothesis(self.kept, fitted, Whitener.of(spliced, values), losses)
        return RefinedTerm(curve, covariance_of(curve, stack, r, jacobian), folds, spliced, explanation)

    def _by_step(self, stack: StackedResiduals, r: Array) -> Array:
        ev = self.world.evidence
        return stack.by_step(r, ev.measured.step, len(ev.steps))

    def _folds(self) -> Iterator[NDArray[np.bool_]]:
        """Flights of the steps that a curve is not to see, some steps at a time, (n,)."""
        apart, step = np.flatnonzero(self.train), self.world.evidence.measured.step
        for i in range(CURVE_FOLDS):
            yield np.isin(step, apart[i::CURVE_FOLDS])

    def _as_stiff_as_needed(self, curve: Curve, values: Values, stack: StackedResiduals) -> Curve:
        """The curve with the roughness that foretells steps unseen best, residuals taken for linear."""
        r = stack.residuals(AugmentedModel(self.world, [curve], self.dwell), values)
        jacobian = slopes_of(self.world, values, stack, curve, self.dwell, r)
        folds = [f[stack.event] for f in self._folds()]

        def unseen(roughness: float) -> float:
            bent, held = replace(curve, roughness=roughness), r.copy()
            for fold in folds:
                held[fold] += jacobian[fold] @ newton_step(bent, stack.without(fold), r, jacobian)
            return float(self._by_step(stack, held)[self.train].sum())

        return replace(curve, roughness=min(ROUGHNESS, key=unseen))

    def _held_out(
        self, curve: Curve, values: Values, stack: StackedResiduals, r: Array, jacobian: Array
    ) -> tuple[Array, Array, Array]:
        """Residuals of openings and landings (n,), each step's with the curve that the others give; these curves."""
        measured, curves = self.world.evidence.measured, []
        p = AugmentedModel(self.world, [curve], self.dwell).predict(values)
        opening, landing = measured.opening_s - p.opening_s, measured.landing_s - p.landing_s
        for fold in self._folds():
            step = newton_step(curve, stack.without(fold[stack.event]), r, jacobian)
            other = curve.moved(curve.values + step)
            curves.append(other.values)
            p = AugmentedModel(self.world, [other], self.dwell).predict(values)
            opening = np.where(fold, measured.opening_s - p.opening_s, opening)
            landing = np.where(fold, measured.landing_s - p.landing_s, landing)
        return opening, landing, np.array(curves)


def plate_loss(world: ForwardModel, values: Values) -> Array:
    """Loss of the plate data by step."""
    data = world.evidence.plate
    loss = robust_loss(world.residuals(values).plate / data.sigma)
    return np.asarray(np.bincount(data.step, loss, minlength=len(world.evidence.steps)), dtype=np.float64)


def known_loss(world: ForwardModel, explanation: Hypothesis, train: NDArray[np.bool_]) -> Array:
    """Loss of a named explanation by step, as `TermSearch.polished` reckons it, on the very steps of its fit."""
    values, ev = explanation.fitted.values, world.evidence
    stack = StackedResiduals.of(world, values, train)
    events = stack.by_step(stack.residuals(world, values), ev.measured.step, len(ev.steps))
    return np.asarray(events + plate_loss(world, values))
