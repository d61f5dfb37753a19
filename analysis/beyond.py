"""Beyond the library: the missing term itself, as a smooth function of one covariate, where no named effect suffices.

The rule kept here: a term is fitted, chosen and judged like a named effect, one event ahead and on steps that the fit
did not see, and must also beat its own constant; what it might be called is said beside it, never instead of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.attribution import THREADS, Candidate, Compared, Explanation
from analysis.beyond_words import in_words
from analysis.covariates import covariates
from analysis.fit import Fitter
from analysis.likelihood import Key, Residuals, Values, Whitener, World, plate_effects
from analysis.robust import robust_loss
from analysis.splines import (
    SHARP,
    TAILS,
    Stack,
    Tried,
    best_start,
    constant_of,
    newton_step,
    slopes_of,
    spread_of,
    table_of,
    try_covariate,
    try_in_flight,
)
from analysis.terms import (
    EVENT_GRIDS,
    IN_FLIGHT,
    SOFT,
    STIFF,
    Curve,
    Spliced,
    Term,
    event_terms,
    knots_of,
    ranges_of,
    spoken,
)
from analysis.thresholds import FROZEN
from model.effects import effect, registry
from model.roll import Predicted

Array = NDArray[np.float64]

FINALISTS = 5
FIRST_TAILS = (0.9, 0.7, 0.5, 0.5, 0.5)  # of the first looks within the flight: see `analysis.splines.TAILS`
AGAIN = 2  # of the finalists that are tried softer, and with finer knots
NEAR = 0.4  # of the best first look's gain: who is nearer is looked at again
ALIKE = 0.8  # correlation beyond which a named effect is said to resemble the term
FARTHEST_S = 2e-3  # a change beyond is another event, not a mark
LIKE = {"since_impact_s": "dwell_s", "impact_mps": "previous_impact_mps"}  # nearest covariate of a whole flight
SOME = 0.01  # from nothing at all no step leads down
GAP_SIGMAS = 1.0  # by which openings move for the contact's gap to be doubted
GOOD = 1.15  # held-out scatter over uncertainty below which no second base is tried


@dataclass(frozen=True)
class Discovery:
    """A missing term.

    Attributes
    ----------
    term
        ``force``, ``friction``, ``threshold`` or ``restitution``.
    of, unit, scale
        Its covariate in words, the unit in which a person reads it, and the factor to it from SI.
    in_words
        What the curve does.
    knots, values, low, high
        The curve with its pointwise 95 % band, (k,), SI.
    term_unit
        Unit of the values.
    seen
        Values of the covariate at the flights, for a rug; empty for a quantity within the flight.
    gain, over_constant
        Held-out gain over the best named explanation, and over the same term as a constant.
    resembles
        Named effects whose mark on the flights is alike, with the correlation.
    rivals
        Other covariates that do as well on held-out steps.
    world, explanation
        The world with the term in it, and the fit there: what `remainder` and error tables take.
    """

    term: str
    of: str
    unit: str
    scale: float
    in_words: str
    knots: Array
    values: Array
    low: Array
    high: Array
    term_unit: str
    seen: Array
    gain: Compared
    over_constant: Compared
    resembles: tuple[tuple[str, float], ...]
    rivals: tuple[str, ...]
    world: Spliced
    explanation: Explanation

    def as_json(self) -> dict[str, object]:
        """For the report."""
        return {
            "term": self.term,
            "of": self.of,
            "in_words": self.in_words,
            "unit": self.term_unit,
            "of_unit": self.unit,
            "knots": (self.scale * self.knots).tolist(),
            "values": self.values.tolist(),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "resembles": [name for name, _ in self.resembles],
            "rivals": list(self.rivals),
        }


@dataclass(frozen=True)
class _Polished:
    """A curve in its world, with the fit of everything else there and the held-out losses."""

    curve: Curve
    spread: Array
    world: Spliced
    explanation: Explanation

    @property
    def per_step(self) -> Array:
        return self.explanation.per_step

    @property
    def held_out(self) -> float:
        return float(self.per_step[self.explanation.fitted.fitter.train].sum())


def discover(world: World, fitter: Fitter, explanation: Explanation, train: NDArray[np.bool_]) -> Discovery | None:
    """Look for a smooth term that explains what the named effects do not.

    Parameters
    ----------
    world, fitter
        The evidence and its fits.
    explanation
        The best of the named effects.
    train
        Steps that may be seen, shape (m,).

    Returns
    -------
    Discovery or None
        None where no term gains on held-out steps over the named effects and its constant; of equals the straightest.
    """
    tables = covariates(world, explanation.fitted.values)
    found: list[_Polished] = []
    for kept in _bases(explanation):
        search = _Search(world, fitter, explanation, kept, train, tables)
        looks = search.first_looks()
        here = sorted((search.polished(t.curve.with_roughness(STIFF)) for t in looks), key=lambda p: p.held_out)
        found += here + [search.polished(p.curve.with_roughness(SOFT)) for p in here[:AGAIN]]
        found += [search.polished(p.curve.finer()) for p in here[:AGAIN] if not p.curve.term.columns]
        least = min(p.held_out for p in found)
        alike = [p for p in found if p.held_out < least + FROZEN.gain_nats]
        best = min(alike, key=lambda p: p.curve.bend)
        same = [p for p in found if p.curve.term == best.curve.term and _tied(p, best, train)]
        best = min(same, key=lambda p: _scatter(p, train))  # how stiff, the folds tell only roughly
        if _scatter(best, train) < GOOD:
            break
    gain = Compared.of(_known_loss(world, explanation, train), best.per_step, train)
    if gain.gain < FROZEN.gain_nats:  # the named effects have been refused already, by what they leave
        return None
    kept = best.explanation.candidates
    flat = _Search(world, fitter, explanation, kept, train, tables).polished(best.curve.flat())
    constant = Compared.of(flat.per_step, best.per_step, train)
    if not constant.beyond(FROZEN.gain_nats, FROZEN.gain_sigmas):
        return None
    rivals = [p for p in found if p is not best and _tied(p, best, train)]
    return _told(world, best, gain, constant, rivals, tables)


def _bases(explanation: Explanation) -> list[tuple[Candidate, ...]]:
    """What stays of the named effects: those of the plate and the instruments first, then all of them."""
    still = tuple(c for c in explanation.candidates if set(c.names) <= plate_effects())
    return [still] if len(still) == len(explanation.candidates) else [still, explanation.candidates]


def _scatter(p: _Polished, train: NDArray[np.bool_]) -> float:
    """Root mean square of held-out landings over their uncertainty, robust against grazes."""
    r, u = p.world.residuals(p.explanation.fitted.values), p.world.uncertainty(p.explanation.fitted.values)
    z = (r.landing_s / np.hypot(u.landing_total_s, 1e-6))[p.world.evidence.judged]
    return float(np.sqrt(np.mean(np.clip(np.nan_to_num(z, nan=6.0), -6.0, 6.0) ** 2)))


def _tied(p: _Polished, best: _Polished, train: NDArray[np.bool_]) -> bool:
    lead = Compared.of(p.per_step, best.per_step, train)
    return not lead.beyond(FROZEN.tie_nats, FROZEN.tie_sigmas)


class _Search:
    """The search for a term beside the named effects ``kept``."""

    def __init__(
        self,
        world: World,
        fitter: Fitter,
        explanation: Explanation,
        kept: tuple[Candidate, ...],
        train: NDArray[np.bool_],
        tables: Mapping[str, Array],
    ) -> None:
        self.world, self.fitter, self.train, self.tables, self.kept = world, fitter, train, tables, kept
        self.free: tuple[Key, ...] = tuple(k for c in kept for k in c.free)
        # calibrations may have been bent to make up for what is missing: all but the contact's own begin anew
        self.values = {
            k: v for k, v in explanation.fitted.values.items() if k in self.free or effect(k[0]).effect.nuisance
        }
        self.dwell = tables["dwell_s"]

    def first_looks(self) -> list[Tried]:
        """All terms on all covariates; those near the best.

        Where openings hang on the contact's gap they are looked at with and without: a wrong model bends the gap.
        """
        both = Stack.of(self.world, self.values, self.train)
        found = self._looked(both)
        if self._gap_shows(both):
            seen = {(t.curve.term.name, t.curve.term.of) for t in found[:FINALISTS]}
            again = self._looked(both.landings())
            found = found[:FINALISTS] + [t for t in again if (t.curve.term.name, t.curve.term.of) not in seen]
        return found

    def _gap_shows(self, stack: Stack) -> bool:
        """Whether the contact's own imperfections move openings by more than these are known."""
        rest = {k: v for k, v in self.values.items() if not effect(k[0]).effect.nuisance}
        r = stack.residuals(self.world, self.values) - stack.residuals(self.world, rest)
        return bool(stack.first.any() and np.median(np.abs(r / stack.sigma_s)[stack.first]) > GAP_SIGMAS)

    def _looked(self, stack: Stack) -> list[Tried]:
        ahead = stack.loss(stack.residuals(self.world, self.values))
        judged = self.world.evidence.judged
        tried: list[Tried] = []
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
        stack: Stack,
        term: Term,
        span: tuple[float, float],
        constant: float,
        known: Mapping[tuple[str, str], Curve],
    ) -> Tried:
        """A term within the flight, begun at what a value for each flight has shown."""
        curve = Curve.even(term, span, len(self.world.evidence))
        start = known.get((term.name, LIKE.get(term.of, "")))
        if term.name != "force":
            values = np.full_like(curve.values, max(constant, SOME)) if start is None else start.at(curve.knots)
            curve = curve.moved(values * (self.world.gravity if term.against_motion else 1.0))
        curve = best_start(self.world, self.values, stack, curve, self.dwell)
        return try_in_flight(self.world, self.values, stack, curve, self.dwell, FIRST_TAILS)

    def polished(self, curve: Curve) -> _Polished:
        """Curve and everything else fitted in turn; judged on the steps that the curve did not see."""
        values = dict(self.values)
        passes = SHARP if curve.term.columns else SHARP[:2]  # a prediction a pass where each flight has its own value
        for tails in ((TAILS[-1], *passes), passes):
            stack = Stack.of(Spliced(self.world, [curve], self.dwell), values, self.train)
            if curve.term.name != "threshold" and len(tails) > len(passes) and self._gap_shows(stack):
                stack = stack.landings()
            curve = try_in_flight(self.world, values, stack, curve, self.dwell, tails).curve
            spliced = Spliced(self.world, [curve], self.dwell)
            twin = Fitter(spliced, self.fitter.priors, self.train)
            fitted = twin.fit(Whitener.of(spliced, values), self.free, values)
            values = fitted.values
        stack = Stack.of(spliced, values, self.train)
        r = stack.residuals(spliced, values)
        jacobian = slopes_of(self.world, values, stack, curve, self.dwell, r)
        held = stack.cut(self._held_out(curve, values, stack, r, jacobian))
        ev = self.world.evidence
        losses = {
            "events": stack.by_step(held, ev.measured.step, len(ev.steps)),
            "plate": _plate_loss(spliced, values),
        }
        whitener = Whitener.of(spliced, values)
        explanation = Explanation(self.kept, fitted, whitener, losses)
        return _Polished(curve, spread_of(curve, stack, r, jacobian), spliced, explanation)

    def _held_out(
        self, curve: Curve, values: Mapping[Key, float], stack: Stack, r: Array, jacobian: Array
    ) -> Residuals:
        """Residuals of each step with the curve that the other folds give."""
        step, out = self.world.evidence.measured.step, Spliced(self.world, [curve], self.dwell).residuals(values)
        for fold in self.fitter.folds:
            seen = replace(stack, train=stack.train & ~fold[step[stack.event]])
            other = curve.moved(curve.values + newton_step(curve, seen, r, jacobian))
            found = Spliced(self.world, [other], self.dwell).residuals(values)
            out = replace(
                out,
                opening_s=np.where(fold[step], found.opening_s, out.opening_s),
                landing_s=np.where(fold[step], found.landing_s, out.landing_s),
            )
        return out


def _plate_loss(world: World, values: Values) -> Array:
    """Loss of the plate data by step."""
    data = world.evidence.plate
    loss = robust_loss(world.residuals(values).plate / data.sigma)
    return np.asarray(np.bincount(data.step, loss, minlength=len(world.evidence.steps)), dtype=np.float64)


def _known_loss(world: World, explanation: Explanation, train: NDArray[np.bool_]) -> Array:
    """Loss of a named explanation by step, as `_Search.polished` reckons it, on the very steps of its fit."""
    values, ev = explanation.fitted.values, world.evidence
    stack = Stack.of(world, values, train)
    events = stack.by_step(stack.residuals(world, values), ev.measured.step, len(ev.steps))
    return np.asarray(events + _plate_loss(world, values))


def _told(
    world: World,
    best: _Polished,
    gain: Compared,
    constant: Compared,
    rivals: Sequence[_Polished],
    tables: Mapping[str, Array],
) -> Discovery:
    curve = best.curve
    words, unit, scale = spoken(curve.term)
    judged = world.evidence.judged
    seen = tables[curve.term.of][judged] if curve.term.columns else np.zeros(0)
    half = 1.96 * best.spread
    names = dict.fromkeys(spoken(p.curve.term)[0] for p in rivals)
    names.pop(words, None)
    return Discovery(
        curve.term.name,
        words,
        unit,
        scale,
        in_words(curve),
        curve.knots,
        curve.values,
        np.clip(curve.values - half, curve.term.low, None),
        np.clip(curve.values + half, None, curve.term.high),
        curve.term.unit,
        seen[np.isfinite(seen)],
        gain,
        constant,
        _resembling(best),
        tuple(names),
        best.world,
        best.explanation,
    )


def _resembling(best: _Polished) -> tuple[tuple[str, float], ...]:
    """Named effects whose mark on landings and openings is like the term's, most alike first."""
    values, plain = best.explanation.fitted.values, best.world.without
    base = plain.predict(values)

    def mark(p: Predicted) -> Array:
        both = np.concatenate(
            [(p.landing_s - base.landing_s)[plain.evidence.judged], (p.opening_s - base.opening_s)[plain.opens]]
        )
        return np.asarray(np.where(np.abs(both) < FARTHEST_S, np.nan_to_num(both), 0.0))

    ours, out = mark(best.world.predict(values)), dict[str, float]()
    for entry in registry():
        e = entry.effect
        if not e.library or e.nuisance or e.name in plate_effects() or e.name in best.explanation.names:
            continue
        for q in (q for q in e.parameters if not q.shape):
            theirs = mark(plain.predict({**values, (e.name, q.name): q.absent + 2.0 * q.typical}))
            size = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
            alike = abs(float(ours @ theirs)) / size if size > 0.0 else 0.0
            out[e.name] = max(out.get(e.name, 0.0), alike)
    return tuple(sorted(((k, v) for k, v in out.items() if v > ALIKE), key=lambda pair: -pair[1]))
