"""Beyond the library: the missing term itself, as a smooth function of one covariate, where no named effect suffices.

The rule kept here: a term is fitted, chosen and judged like a named effect, one event ahead and on steps that the fit
did not see, and must also beat its own constant; what it might be called is said beside it, never instead of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.attribution.candidates import Candidate
from analysis.attribution.comparison import LogScoreDifference
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.discovery.describe import in_words
from analysis.discovery.search import RefinedTerm, TermSearch, known_loss
from analysis.discovery.terms import AugmentedModel, spoken
from analysis.parallel import THREADS
from analysis.residuals.covariates import covariates
from analysis.residuals.forward_model import ForwardModel, plate_effects
from analysis.thresholds import FROZEN, Thresholds
from model.effects.registry import registry
from model.integrator.one_step import Predicted

Array = NDArray[np.float64]

REACHES = {  # what says how far flights go in a quantity that varies within them
    "speed_mps": "impact_mps",
    "velocity_mps": "plate_speed_at_takeoff_mps",
    "absolute_velocity_mps": "plate_speed_at_takeoff_mps",
    "since_takeoff_s": "flight_s",
    "since_impact_s": "flight_s",
}
AGAIN = 2  # of the finalists that may be tried with finer knots
FARTHEST_S = 2e-3  # a change beyond is another event, not a mark


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
        The curve with its pointwise 95 % band, (k,), SI; straight between these points, constant beyond. A force is
        positive where it pushes up.
    term_unit
        Unit of the values.
    seen
        Values of the covariate at the flights, or how far flights go in a quantity that varies within them: for a rug.
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
    gain: LogScoreDifference
    over_constant: LogScoreDifference
    resembles: tuple[tuple[str, float], ...]
    rivals: tuple[str, ...]
    world: AugmentedModel
    explanation: Hypothesis

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


def discover(
    world: ForwardModel, fitter: Fitter, explanation: Hypothesis, limits: Thresholds = FROZEN
) -> Discovery | None:
    """Look for a smooth term that explains what the named effects do not.

    Parameters
    ----------
    world, fitter
        The evidence and its fits.
    explanation
        The best of the named effects.
    limits
        Thresholds of the verdict.

    Returns
    -------
    Discovery or None
        None where no term gains on held-out steps over the named effects and its constant; of equals the straightest.
    """
    tables, train = covariates(world, explanation.fitted.values), fitter.train
    found: list[RefinedTerm] = []
    for kept in _bases(explanation):
        found += _finalists(TermSearch(world, fitter, explanation, kept, train, tables), limits)
        best = _straightest(found, limits)
        if _scatter(best) < limits.base_rms:
            break
    gain = LogScoreDifference.of(known_loss(world, explanation, train), best.per_step, train)
    if gain.gain < limits.gain_nats:  # the named effects have been refused already, by what they leave
        return None
    kept = best.explanation.candidates
    flat = TermSearch(world, fitter, explanation, kept, train, tables).polished(best.curve.flat(len(world.evidence)))
    constant = LogScoreDifference.of(flat.per_step, best.per_step, train)
    if not constant.exceeds(limits.gain_nats, limits.gain_sigmas):
        return None
    rivals = [p for p in found if p is not best and _tied(p, best, limits)]
    return _told(world, best, (gain, constant), rivals, tables, limits)


def _straightest(found: Sequence[RefinedTerm], limits: Thresholds) -> RefinedTerm:
    """Of what is best on held-out steps, within what could be luck, the straightest term; of it, what fits closest."""
    least = min(p.held_out for p in found) + limits.gain_nats
    term = min((p for p in found if p.held_out < least), key=lambda p: p.curve.bend).curve.term
    same = [p for p in found if p.curve.term == term and p.held_out < least]
    return min(same, key=_scatter)  # how stiff, the held-out steps tell only roughly


def _finalists(search: TermSearch, limits: Thresholds) -> list[RefinedTerm]:
    """The best first looks in joint fits; the first of them with finer knots, too, if within the flight it falls short.

    A term that bends sharply may lose to one that bends less, so that the second best is given the same chance.
    """
    with ThreadPoolExecutor(THREADS) as pool:
        found = sorted(pool.map(lambda t: search.polished(t.curve), search.first_looks()), key=lambda p: p.held_out)
        falls_short = not found[0].curve.term.columns and _scatter(found[0]) >= limits.knots_rms
        again = [p.curve.finer() for p in found[:AGAIN] if falls_short and not p.curve.term.columns]
        return found + list(pool.map(search.polished, again))


def _bases(explanation: Hypothesis) -> list[tuple[Candidate, ...]]:
    """What stays of the named effects: those of the plate and the instruments first, then all of them."""
    still = tuple(c for c in explanation.candidates if set(c.names) <= plate_effects())
    return [still] if len(still) == len(explanation.candidates) else [still, explanation.candidates]


def _scatter(p: RefinedTerm) -> float:
    """Root mean square of all scored landings over their uncertainty, clipped against grazes."""
    r, u = p.world.residuals(p.explanation.fitted.values), p.world.uncertainty(p.explanation.fitted.values)
    z = (r.landing_s / np.hypot(u.landing_total_s, 1e-6))[p.world.evidence.scored]
    return float(np.sqrt(np.mean(np.clip(np.nan_to_num(z, nan=6.0), -6.0, 6.0) ** 2)))


def _tied(p: RefinedTerm, best: RefinedTerm, limits: Thresholds) -> bool:
    lead = LogScoreDifference.of(p.per_step, best.per_step, best.explanation.fitted.fitter.train)
    return not lead.exceeds(limits.tie_nats, limits.tie_sigmas)


def _told(
    world: ForwardModel,
    best: RefinedTerm,
    gains: tuple[LogScoreDifference, LogScoreDifference],
    rivals: Sequence[RefinedTerm],
    tables: Mapping[str, Array],
    limits: Thresholds,
) -> Discovery:
    curve = best.curve
    words, unit, scale = spoken(curve.term)
    judged = world.evidence.scored
    seen = tables[curve.term.of if curve.term.columns else REACHES.get(curve.term.of, curve.term.of)][judged]
    told, half = curve.at(curve.points), best.band
    low, high = np.clip(told - half, curve.term.low, None), np.clip(told + half, None, curve.term.high)
    if curve.term.name == "force" and curve.term.columns:  # a pull, as it is fitted; a force points up
        told, low, high = -told, -high, -low
    names = dict.fromkeys(spoken(p.curve.term)[0] for p in rivals)
    names.pop(words, None)
    return Discovery(
        curve.term.name,
        words,
        unit,
        scale,
        in_words(curve),
        curve.points,
        told,
        low,
        high,
        curve.term.unit,
        seen[np.isfinite(seen)],
        *gains,
        _resembling(best, limits.similar_correlation),
        tuple(names),
        best.world,
        best.explanation,
    )


def _resembling(best: RefinedTerm, least: float) -> tuple[tuple[str, float], ...]:
    """Named effects whose mark on landings and openings is like the term's, most alike first."""
    values, plain = best.explanation.fitted.values, best.world.without
    base = plain.predict(values)

    def mark(p: Predicted) -> Array:
        both = np.concatenate(
            [(p.landing_s - base.landing_s)[plain.evidence.scored], (p.opening_s - base.opening_s)[plain.from_rest]]
        )
        return np.asarray(np.where(np.abs(both) < FARTHEST_S, np.nan_to_num(both), 0.0))

    ours, out = mark(best.world.predict(values)), dict[str, float]()
    for entry in registry():
        e = entry.effect
        if not e.library or e.nuisance or e.name in plate_effects() or e.name in best.explanation.names:
            continue
        for q in (q for q in e.parameters if not q.is_shape):
            theirs = mark(plain.predict({**values, (e.name, q.name): q.null_value + 2.0 * q.scale}))
            size = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
            alike = abs(float(ours @ theirs)) / size if size > 0.0 else 0.0
            out[e.name] = max(out.get(e.name, 0.0), alike)
    return tuple(sorted(((k, v) for k, v in out.items() if v > least), key=lambda pair: -pair[1]))
