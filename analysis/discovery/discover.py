"""Nonparametric discovery: the missing term as a smooth function of one covariate, where no named effect suffices.

A term is fitted and judged like a named effect, one event ahead and on steps that the fit did not see. It must also
gain over its own constant. Similar named effects are reported with it, never in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from analysis.attribution.choice import LogScoreDifference, tied
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.computing import THREADS
from analysis.discovery.search import RefinedTerm, TermSearch, named_loss
from analysis.discovery.symbolic import FittedForm, Forms, search_forms
from analysis.discovery.terms import IN_FLIGHT_WORDS, Curve, label
from analysis.residuals.covariates import Covariate
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit
from analysis.residuals.prediction_errors import Errors, held_out_errors, noise_floors_us, scored_rows
from analysis.residuals.values import plate_effects
from analysis.thresholds import ANOTHER_EVENT_S, FROZEN, Thresholds
from kernels.arrays import Floats
from model.effects.registry import registry
from model.integrator.one_step import Predicted

REACHES = {  # covariate of a whole flight that gives the range of a quantity within it
    "speed_mps": "impact_mps",
    "velocity_mps": "plate_speed_at_takeoff_mps",
    "absolute_velocity_mps": "plate_speed_at_takeoff_mps",
    "since_takeoff_s": "flight_s",
    "since_impact_s": "flight_s",
}


@dataclass(frozen=True)
class Band:
    """A curve with its pointwise 95 % band, (k,), SI; straight between these points, constant beyond.

    ``unit`` is that of the values.
    """

    knots: Floats
    values: Floats
    low: Floats
    high: Floats
    unit: str


@dataclass(frozen=True)
class Discovery:
    """A missing term."""

    term: str  # ``force``, ``friction``, ``threshold`` or ``restitution``
    covariate: Covariate  # name of its covariate, the unit in which it is printed, and the factor to it from SI
    description: str  # the curve in one sentence
    curve: Band  # the term over the covariate. A force is positive where it pushes up.
    # values of the covariate at the flights, or the range of each flight in a quantity that varies within it
    seen: Floats
    gain: LogScoreDifference  # held-out log-score gain over the best named hypothesis
    # named effects that shift the flights in a similar pattern, with the correlation
    similar_effects: tuple[tuple[str, float], ...]
    tied_covariates: tuple[str, ...]  # other covariates that do as well on held-out steps
    after: Errors  # errors on the reserved steps with the term, by the suggested formula where there is one
    noise_floor_us: float  # rms that noise leaves of landings there
    of: str = ""  # name of the covariate for programs
    forms: tuple[FittedForm, ...] = ()  # formulas fitted in its place, best first
    suggested: str = ""  # name of the one to prefer to the curve; empty: the curve
    instead_of: tuple[str, ...] = ()  # named effects that the term was fitted without
    p_lack_of_fit: float = 1.0  # probability of what the term leaves of flights

    @property
    def within_flight(self) -> bool:
        """Whether it varies within the flight."""
        return self.of in IN_FLIGHT_WORDS

    def refutes(self, limits: Thresholds) -> bool:
        """Whether a formula in place of named effects foretells held-out steps better and leaves only noise."""
        better = self.gain.gain > limits.gain_nats and self.p_lack_of_fit >= limits.law_p
        return better and bool(self.suggested) and bool(self.instead_of)

    @property
    def form(self) -> FittedForm | None:
        """The suggested formula."""
        return next((form for form in self.forms if form.name == self.suggested), None)


def discover(
    model: ForwardModel, fitter: Fitter, explanation: Hypothesis, limits: Thresholds = FROZEN, *, in_place: bool = False
) -> Discovery | None:
    """Search for a smooth term that explains what the named effects do not.

    None where no term gains on held-out steps over the named effects and its constant. Where a formula does as well as
    the best curve, the term is the one that it is a formula of; else, of those within chance of the best, the one of
    least curvature.

    ``explanation`` is the best set of named effects. With ``in_place`` only what could refute it is looked for: a term
    in the place of its effects on the ball, and none where every curve there loses to them. Decision 712.
    """
    train, tables = fitter.train, model.covariates(explanation.fitted.values)
    named = named_loss(model, explanation, train)
    most = float(named[train].sum()) + limits.gain_nats if in_place else np.inf
    searched = _found(model, fitter, explanation, tables, limits, most)
    if searched is None:
        return None
    found, forms = searched
    best, after = forms.best, forms.explanation
    gain = LogScoreDifference.of(named, after.per_step, train)
    if gain.gain < limits.gain_nats:  # that named effects leave more than noise is known already
        return None
    level = TermSearch(model, fitter, explanation, after.candidates, tables).refine(
        best.curve.without_covariate(len(model.observations))
    )
    # a curve that does no better than its constant shows no law of the covariate
    if not LogScoreDifference.of(level.per_step, after.per_step, train).exceeds(limits.gain_nats, limits.gain_sigmas):
        return None
    as_good = [p for p in found if p is not best and tied(after.per_step, p.per_step, train, limits)]
    instead_of = tuple(name for name in explanation.names if name not in after.names)
    return _discovery(forms, gain, as_good, instead_of, tables, limits)


def _found(
    model: ForwardModel, fitter: Fitter, explanation: Hypothesis, tables: Mapping[str, Floats], limits: Thresholds,
    most: float,
) -> tuple[list[RefinedTerm], Forms] | None:  # fmt: skip
    """All terms that were fitted, and the one to report with its formulas.

    Where ``most`` is finite, only terms in place of the effects on the ball; None where each loses more than that.
    """
    found, laws = list[RefinedTerm](), list[Forms]()
    # the effects of plate and instruments are held on to first, then all named ones
    still = tuple(c for c in explanation.candidates if set(c.names) <= plate_effects())
    every = explanation.candidates
    for named in (still,) if len(still) == len(every) or np.isfinite(most) else (still, every):
        search = TermSearch(model, fitter, explanation, named, tables, in_place=bool(np.isfinite(most)))
        fresh = _finalists(search, limits)
        found += fresh
        if all(p.held_out > most for p in fresh):
            return None
        # of the terms within chance of the best the least curved; of its curves, that of least scatter
        able = [p for p in found if p.held_out < min(x.held_out for x in found) + limits.gain_nats]
        term = min(able, key=lambda p: p.curve.total_curvature).curve.term
        best = min((p for p in able if p.curve.term == term), key=lambda p: p.scatter)
        # formulas of that term, then of the others until one suffices: a curve may have stopped short of its best
        others = {p.curve.term: p for p in sorted(fresh, key=lambda p: -p.held_out)}
        for p in (best, *reversed(others.values())):
            if all(forms.best is not p for forms in laws):
                laws.append(search_forms(p, tables, limits))
            if suffices := min(best.scatter, *(forms.scatter for forms in laws)) < limits.base_rms:
                break
        if suffices:
            break
    # a formula that does as well as the best curve goes before every curve
    forms = min(laws, key=lambda forms: forms.penalised)
    if not tied(best.per_step, forms.explanation.per_step, fitter.train, limits):
        forms = next(forms for forms in laws if forms.best is best)
    return found, forms


def _finalists(search: TermSearch, limits: Thresholds) -> list[RefinedTerm]:
    """Joint fits of the screened terms; the first two within the flight with finer knots, too, if the first misfits.

    A term that bends sharply may lose to one that bends less, so that the second best is refined as well.
    """
    with ThreadPoolExecutor(THREADS) as pool:
        found = sorted(pool.map(lambda t: search.refine(t.curve), search.screen()), key=lambda p: p.held_out)
        falls_short = bool(found) and not found[0].curve.term.columns and found[0].scatter >= limits.knots_rms
        # where all fall short of the noise the two best may have finer knots
        again = [p.curve.finer() for p in found[:2] if falls_short and not p.curve.term.columns]
        return found + list(pool.map(search.refine, again))


def _discovery(
    forms: Forms, gain: LogScoreDifference, others: Sequence[RefinedTerm], instead_of: tuple[str, ...],
    tables: Mapping[str, Floats], limits: Thresholds,
) -> Discovery:  # fmt: skip
    """The chosen term as numbers and names."""
    best, model, fitted = forms.best, forms.explanation.model, forms.explanation.fitted
    curve, covariate = best.curve, Covariate(*label(best.curve.term))
    seen = tables[curve.term.of if curve.term.columns else REACHES.get(curve.term.of, curve.term.of)]
    seen = seen[model.observations.scored]
    values, half = curve.at(curve.points), best.band
    low, high = np.clip(values - half, curve.term.low, None), np.clip(values + half, None, curve.term.high)
    if curve.term.name == "force" and curve.term.columns:  # fitted as a pull; a force points up
        values, low, high = -values, -high, -low
    names = dict.fromkeys(label(p.curve.term)[0] for p in others)
    names.pop(covariate.words, None)
    rows, left_out = scored_rows(model, fitted.values, ~fitted.fitter.train)
    return Discovery(
        curve.term.name, covariate, describe(curve), Band(curve.points, values, low, high, curve.term.unit),
        seen[np.isfinite(seen)], gain, _similar_effects(best, limits.similar_correlation), tuple(names),
        held_out_errors(model, fitted.values, rows, left_out), noise_floors_us(model, fitted.values, rows)[0],
        curve.term.of, forms.tried, forms.suggested, instead_of,
        goodness_of_fit(model, fitted.values, limits).p_lack_of_fit,
    )  # fmt: skip


def _similar_effects(best: RefinedTerm, least: float) -> tuple[tuple[str, float], ...]:
    """Named effects whose shift of landings and openings correlates with the term's, most similar first."""
    values, plain = best.explanation.fitted.values, best.model.without
    base = plain.predict(values)

    def shift(p: Predicted) -> Floats:
        both = np.concatenate(
            [(p.landing_s - base.landing_s)[plain.observations.scored], (p.opening_s - base.opening_s)[plain.from_rest]]
        )
        # a flight that became another one shifts by a period, not by the effect
        return np.asarray(np.where(np.abs(both) < ANOTHER_EVENT_S, np.nan_to_num(both), 0.0))

    ours, out = shift(best.model.predict(values)), dict[str, float]()
    for entry in registry():
        e = entry.effect
        if not e.library or e.nuisance or e.name in plate_effects() or e.name in best.explanation.names:
            continue
        for q in (q for q in e.parameters if not q.is_shape):
            theirs = shift(plain.predict({**values, (e.name, q.name): q.null_value + 2.0 * q.scale}))
            size = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
            alike = abs(float(ours @ theirs)) / size if size > 0.0 else 0.0
            out[e.name] = max(out.get(e.name, 0.0), alike)
    return tuple(sorted(((k, v) for k, v in out.items() if v > least), key=lambda pair: -pair[1]))


POINTS = 61  # at which the curve is evaluated
MOSTLY = 0.8  # share of the range that the ends of a rise or fall must span; share that happens in a narrow part


def describe(curve: Curve) -> str:
    """One sentence, as "dry friction rises from 0.01 g to 0.1 g between a height of 0 mm and 4.2 mm"."""
    words, unit, scale = label(curve.term)
    x = np.linspace(curve.knots[0], curve.knots[-1], POINTS)
    y = curve.at(x)
    name = curve.term.words
    if curve.term.name == "force":
        y = y if curve.term.columns else -y
        name = "a downward pull" if abs(np.max(y)) >= abs(np.min(y)) else "an upward push"
        y = y if name == "a downward pull" else -y
    span = float(np.ptp(y))
    if span <= 0.0:
        return f"{name} is {_number(y[0], curve.term.unit)} whatever the {words}"

    def place(i: int) -> str:
        return _number(scale * float(x[i]), unit)

    def level(i: int) -> str:
        return _number(float(y[i]), curve.term.unit)

    top, bottom = int(np.argmax(y)), int(np.argmin(y))
    if abs(y[-1] - y[0]) >= MOSTLY * span:
        # the ends of the middle `MOSTLY` of the rise or fall
        part, rest = (y - y[0]) / (y[-1] - y[0]), 0.5 * (1.0 - MOSTLY)
        first, last = int(np.argmax(part >= rest)), int(np.argmax(part >= 1.0 - rest))
        verb = "rises" if y[-1] > y[0] else "falls"
        text = f"{name} {verb} from {level(0)} to {level(-1)} as {words} goes from {place(0)} to {place(-1)}"
        narrow = last - first < 0.4 * POINTS
        return text + (f", mostly between {place(first)} and {place(last)}" if narrow else "")
    if y[top] - max(y[0], y[-1]) >= min(y[0], y[-1]) - y[bottom]:
        peak = f"{name} is greatest, {level(top)}, where {words} is about {place(top)}"
        return f"{peak}, and {level(bottom)} at {place(bottom)}"
    return f"{name} is least, {level(bottom)}, where {words} is about {place(bottom)}, and {level(top)} at {place(top)}"


def _number(value: float, unit: str) -> str:
    text = f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"
    return text if unit in ("", "1") else f"{text} {unit}"
