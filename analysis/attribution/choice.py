"""Judgement by held-out steps: paired differences of log scores, choice among candidates, and backward elimination.

Steps of a run, or runs where many are judged together, are the independent replicates. Each one's contribution is also
counted clipped, so that no few of them decide (decision 370). A candidate is accepted, refused with its reason, or tied
(decision 92); idle effects are left out again, special cases stand in place of fuller forms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.attribution.candidates import Candidate, null_value_of, parameter_of
from analysis.attribution.chance import ChanceGains
from analysis.attribution.hypothesis import Hypothesis, Refits, Rejected
from analysis.residuals.lack_of_fit import plate_rms_standardised
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import TREND, ParameterId
from analysis.thresholds import FROZEN, MOST_OF_A_STEP_NATS, Thresholds
from kernels.arrays import Bools, Floats
from model.effects.registry import effect


@dataclass(frozen=True)
class LogScoreDifference:
    """Gain of one hypothesis over another on held-out steps."""

    gain: float  # nats
    error: float  # its standard error
    # each step's contribution clipped at `MOST_OF_A_STEP_NATS` either way: a few steps that gain hundreds of nats
    # spread the sum without making it doubtful
    clipped: float
    clipped_error: float  # standard error of that

    @classmethod
    def of(cls, worse: Floats, better: Floats, train: Bools) -> LogScoreDifference:
        """Gain of ``better`` over ``worse``, both losses by step."""
        d = (worse - better)[train]
        return cls(*_sum(d), *_sum(np.clip(d, -MOST_OF_A_STEP_NATS, MOST_OF_A_STEP_NATS)))

    def exceeds(self, nats: float, sigmas: float) -> bool:
        """Whether it is at least so many nats and standard errors, unclipped or clipped.

        A sum below half its own standard error never is.
        """
        return self.gain > max(nats, 0.5 * self.error) and (
            self.gain > sigmas * self.error or self.clipped > max(nats, sigmas * self.clipped_error)
        )


def tied(best: Floats, other: Floats, train: Bools, limits: Thresholds) -> bool:
    """Whether losses by step do not distinguish ``other`` from ``best``."""
    return not LogScoreDifference.of(other, best, train).exceeds(limits.tie_nats, limits.tie_sigmas)


def required_gain(depth: int, limits: Thresholds) -> tuple[float, float]:
    """Least held-out gain of one effect more, nats and standard errors, where ``depth`` effects are named."""
    if depth:
        return limits.next_effect_nats, limits.next_effect_sigmas
    return limits.first_effect_nats, limits.first_effect_sigmas


def gain_refusal(gain: LogScoreDifference, nats: float, sigmas: float, replicate: str = "step") -> str | None:
    """Reason in words that forbids an effect of this gain; None where the gain suffices.

    Parameters
    ----------
    gain
    nats, sigmas
        What is required, see `required_gain`.
    replicate
        What the gain is a sum over: "step" or "run".
    """
    if not gain.gain > nats:
        return f"too small a gain: {gain.gain:.1f} nats, wanted {nats:g}"
    if gain.exceeds(nats, sigmas):
        return None
    return (
        f"the {replicate}s do not agree on its gain: {gain.gain:.0f} +- {gain.error:.0f} nats, "
        f"{gain.clipped:.0f} +- {gain.clipped_error:.0f} where a {replicate} counts {MOST_OF_A_STEP_NATS:g} at most; "
        f"a gain of {nats:g} by {sigmas:g} standard errors is required"
    )


def chance_refusal(p: float, limits: Thresholds) -> str | None:
    """Reason in words where the best of all candidates gains as much by chance with the probability ``p``; or None."""
    if p <= limits.best_of_all_p:
        return None
    return f"chance lets the best of all candidates gain as much: p = {p:.2g}, wanted {limits.best_of_all_p:.2g}"


def penalised_best(top: Floats, losses: Sequence[Floats], costs: Sequence[float], train: Bools) -> int:
    """Index of the hypothesis of lowest penalised loss, among several that tie.

    Parameters
    ----------
    top
        Losses by step of the one of lowest sum.
    losses, costs
        Losses by step and penalty of each hypothesis, nats; each step is clipped at `MOST_OF_A_STEP_NATS`.
    train
        Steps that count.
    """
    return int(
        np.argmin([LogScoreDifference.of(x, top, train).clipped + cost for x, cost in zip(losses, costs, strict=True)])
    )


def _sum(d: Floats) -> tuple[float, float]:
    return float(d.sum()), float(np.sqrt(len(d)) * np.std(d, ddof=1)) if len(d) > 1 else np.inf


class Judge:
    """Comparison of hypotheses by steps that their fits did not see.

    Parameters
    ----------
    train
        Steps that selection may use, shape (m,).
    limits
        Thresholds of the verdict.
    """

    def __init__(self, train: Bools, limits: Thresholds = FROZEN) -> None:
        self.train, self.limits = train, limits

    def loss(self, x: Hypothesis) -> float:
        """Held-out loss over all steps that selection may use."""
        return float(x.per_step[self.train].sum())

    def gain(self, worse: Hypothesis, better: Hypothesis) -> LogScoreDifference:
        """Held-out gain of one hypothesis over another."""
        return LogScoreDifference.of(worse.per_step, better.per_step, self.train)

    def finds(self, best: Hypothesis, x: Hypothesis) -> bool:
        """Whether landings that were lost are found: then the few steps that hold many flights decide."""
        found = x.whitener.excess_s[1] < self.limits.found_excess * best.whitener.excess_s[1]
        return best.whitener.lost and found and self.gain(best, x).gain > self.limits.found_nats

    def tied(self, best: Hypothesis, x: Hypothesis) -> bool:
        """Whether the data do not distinguish ``x`` from ``best``."""
        return not self.finds(x, best) and tied(best.per_step, x.per_step, self.train, self.limits)

    def refuted(self, x: Hypothesis, beside: Hypothesis) -> bool:
        """Whether ``x`` leaves more than noise where another hypothesis does not.

        That refutes it, however much steps differ in how clearly they distinguish the two.
        """
        ratio = self.limits.noise_like_ratio
        return beside.noise_like(ratio) and not x.noise_like(ratio)

    def refusal(self, best: Hypothesis, x: Hypothesis, depth: int, chance: ChanceGains | None = None) -> str | None:
        """Reason in words that forbids ``x`` in place of ``best``; None where nothing does.

        Parameters
        ----------
        best, x
            Hypotheses without and with a candidate.
        depth
            Number of effects named before.
        chance
            What the best of all candidates gains by chance beside ``best``; not tested where None.
        """
        limits = self.limits
        nats, sigmas = required_gain(depth, limits)
        if self.finds(best, x) or self.refuted(best, x):  # a cause may show in few steps
            sigmas = limits.few_steps_sigmas
        gain = self.gain(best, x)
        if why := gain_refusal(gain, nats, sigmas):
            return why
        # landings that are lost either way say nothing against what recorded volts show without a flight
        shown = best.whitener.lost and x.whitener.lost and set(x.free) - set(best.free) <= x.fitter.identified.keys()
        for channel in ["plate"] if shown else x.losses:
            change = LogScoreDifference.of(x.losses[channel], best.losses[channel], self.train)
            worse = change.exceeds(limits.worse_nats, limits.worse_sigmas)
            if worse and not (channel == "plate" and self._trifling(best, x, change, gain)):
                return f"the {channel} data fit worse with it, by {change.gain:.0f} +- {change.error:.0f} nats"
        if any(c.free and not x.fitted.differs(c.free) for c in x.candidates if c not in best.candidates):
            return "the 95 % intervals of its parameters hold the values at which it does nothing"
        return None if chance is None else chance_refusal(chance.p(x), limits)

    def _trifling(self, best: Hypothesis, x: Hypothesis, loss: LogScoreDifference, gain: LogScoreDifference) -> bool:
        """Whether plate data lose a small part of what the events gain and are still noise, or were none before.

        While events were lost, calibrations could follow the plate's noise; found events hold them.
        """
        before, after = (plate_rms_standardised(h.model, h.fitted.values) for h in (best, x))
        noise, small = self.limits.noise_like_ratio, loss.gain <= self.limits.tolerated_plate_loss * gain.gain
        return small and (after < noise or before >= noise)

    def choose(
        self, best: Hypothesis, found: Sequence[Hypothesis], depth: int, chance: ChanceGains | None = None
    ) -> Hypothesis | None:
        """The candidate of lowest held-out loss that passes; of those that tie with it, that of lowest penalised loss.

        The penalty counts its parameters and the prior of the calibrations that it moves. A candidate that leaves more
        than noise may, or strains a calibration, and would need a second cause as well, comes after those that do not.
        """
        ranked = sorted(found, key=self.loss)
        passing = (x for x in ranked if self.refusal(best, x, depth, chance) is None)
        top = next(passing, None)
        if top is None:
            return None
        after = ranked[ranked.index(top) + 1 :]  # what chance does is drawn only for those that could be chosen
        close = [top, *(x for x in after if self.tied(top, x) and self.refusal(best, x, depth, chance) is None)]
        if len(close) > 1:
            close = [x for x in close if not x.strained and x.passes(self.limits)] or close
        return self.cheapest(close)

    def cheapest(self, close: Sequence[Hypothesis]) -> Hypothesis:
        """Of hypotheses that tie with the first one, that of lowest penalised loss."""
        costs = [x.fitted.prior_penalty + self.limits.tie_nats * x.numbers for x in close]
        return close[penalised_best(close[0].per_step, [x.per_step for x in close], costs, self.train)]

    def rejected(
        self,
        best: Hypothesis,
        found: Sequence[Hypothesis],
        depth: int,
        chosen: Hypothesis | None,
        chance: ChanceGains | None = None,
    ) -> Rejected | None:
        """The refused candidate of the greatest gain, if it gains more than what was chosen; None where there is none.

        Parameters
        ----------
        best
            The hypothesis that candidates were added to.
        found
            The candidates of one round.
        depth
            Number of effects named before.
        chosen
            The accepted candidate of that round, if any.
        chance
            What the best of all candidates gains by chance beside ``best``; not tested where None.
        """
        least = 0.0 if chosen is None else self.gain(best, chosen).gain
        for x in sorted(found, key=self.loss):
            gain = self.gain(best, x)
            if not gain.gain > max(least, self.limits.reported_nats):
                break
            reason = self.refusal(best, x, depth, chance)
            if reason is not None:
                return Rejected(x.candidates[-1].names, gain.gain, gain.error, reason)
        return None


class Pruning:
    """Simplifications of a hypothesis that held-out steps do not contradict.

    Parameters
    ----------
    refits
        How hypotheses are fitted.
    judge
        Comparison by held-out steps.
    """

    def __init__(self, refits: Refits, judge: Judge) -> None:
        self.refits, self.judge, self.limits = refits, judge, judge.limits

    def without_idle(self, best: Hypothesis, among: Sequence[Candidate], rounds: list[str]) -> Hypothesis:
        """The hypothesis without one ``among`` its effects that the others have made idle; ``rounds`` gets a line."""
        for candidate in among:
            rest = tuple(c for c in best.candidates if c is not candidate)
            x = self.refits.attempted(rest, self._without, best, candidate, rest)
            if x is None:
                continue
            needed = self.judge.gain(x, best).exceeds(self.limits.tie_nats, self.limits.tie_sigmas)
            if not needed and not self.judge.refuted(x, best):
                rounds.append(f"step back: {' + '.join(candidate.names)} is no longer needed")
                return x
        return best

    def _without(self, best: Hypothesis, candidate: Candidate, rest: tuple[Candidate, ...]) -> Hypothesis | None:
        """The hypothesis refitted with the ``rest`` of its candidates, without one; None where it is surely needed."""
        start = {k: v for k, v in best.fitted.values.items() if k not in candidate.free}
        free = tuple(k for c in rest for k in c.free)
        # far above that, no weights would let it do as well
        most = best.fitted.loss + 10.0 * self.limits.found_nats
        fitted = self.refits.fitter.fit(best.whitener, free, start, most=most)
        # else to the end: a fit that had stopped short would let any effect look needed
        return None if fitted.loss > most else self.refits.scored(rest, self.refits.reweighted(fitted))

    def without_null(self, best: Hypothesis, rounds: list[str]) -> Hypothesis:
        """The hypothesis without candidates whose parameters' intervals hold, in the end, their null values."""
        while best.candidates:
            # shapes by themselves are no size that could be null
            sized = [c for c in best.candidates if not all(parameter_of(k).is_shape for k in c.free)]
            null = next((c for c in sized if not best.fitted.differs(c.free)), None)
            if null is None:
                break
            rest = tuple(c for c in best.candidates if c is not null and not _is_trend_of(c, null))
            free = tuple(k for c in rest for k in c.free)
            start = {k: v for k, v in best.fitted.values.items() if k in free or k in self.refits.fitter.priors}
            fitted = self.refits.attempted(rest, self.refits.converged, rest, best.whitener, free, start)
            if fitted is None:
                break
            best = fitted
            rounds.append(f"step back: the 95 % intervals of {' + '.join(null.names)} hold the values of no effect")
        return best

    def simplified(self, best: Hypothesis, pool: Sequence[Candidate], rounds: list[str]) -> Hypothesis:
        """The hypothesis with special cases in place of its effects where no fuller form is better beyond doubt.

        A fit of the special case may have stopped short when it was tried: it begins where the fuller form stands.
        """
        for i, candidate in enumerate(best.candidates):
            for simpler in pool:
                if len(simpler.free) >= len(candidate.free) or not set(simpler.names) <= contained_in(candidate.names):
                    continue
                x = self.refits.attempted((simpler,), self._in_place, best, i, simpler)
                if x is None:
                    continue
                if self.does_as_well(x, best, candidate, simpler):
                    rounds.append(f"step back: a simpler {' + '.join(simpler.names)} does as well")
                    return self.simplified(x, pool, rounds)
        return best

    def does_as_well(self, x: Hypothesis, fuller: Hypothesis, candidate: Candidate, simpler: Candidate) -> bool:
        """Whether ``x``, with a ``simpler`` form in place of the ``candidate`` of the ``fuller`` one, may stand."""
        return self._as_good(fuller, x) or self._extra_is_null(fuller, x, candidate, simpler)

    def without_excess(self, x: Hypothesis) -> Hypothesis:
        """Refit the final hypothesis with zero excess noise; keep it if the profile loss falls by more than 4 nats.

        A fit's own misses count as excess and widen its weights. Only the last fit is made so: while candidates are
        compared, all are fitted alike.
        """
        lean = Whitener.of(self.refits.model, x.fitted.values, lean=True)
        fitted = self.refits.fitter.fit(lean, x.free, x.fitted.values)
        before, after = (self.refits.profile_loss(x.whitener, f.values) for f in (x.fitted, fitted))
        return self.refits.scored(x.candidates, fitted) if after < before - self.limits.negligible_nats else x

    def _in_place(self, best: Hypothesis, i: int, simpler: Candidate) -> Hypothesis:
        """The hypothesis with its ``i``-th candidate, and its trends, replaced by a special case's, fitted."""
        candidate, values = best.candidates[i], best.fitted.values
        origins = {own: _origin(own, candidate) for own in simpler.free}
        chosen, replaced = [], set(candidate.free)
        for c in best.candidates:
            if c is candidate:
                chosen.append(simpler)
            elif not _is_trend_of(c, candidate):
                chosen.append(c)
            else:
                replaced |= set(c.free)
                # a drift goes over to the special case's own name of the parameter
                trends = tuple((n, q + TREND) for (n, q), (m, p) in origins.items() if (m, p + TREND) in c.free)
                if trends:
                    chosen.append(Candidate((trends[0][0], *c.names[1:]), trends, ({},)))
        free = tuple(k for c in chosen for k in c.free)
        origins |= {(n, q + TREND): (m, p + TREND) for (n, q), (m, p) in origins.items()}
        known = {k: v for k, v in values.items() if k not in replaced or k in free}
        reduced = {k: values.get(origins.get(k, k), null_value_of(k)) for k in free}
        # and its own starts: the special case may have its minimum elsewhere
        points = [{**reduced, **point, **known} for point in ({}, *simpler.starts)]
        start = min(points, key=lambda point: self.refits.profile_loss(best.whitener, point))
        return self.refits.converged(tuple(chosen), best.whitener, free, start)

    def _extra_is_null(self, best: Hypothesis, x: Hypothesis, candidate: Candidate, simpler: Candidate) -> bool:
        """Whether the intervals of what the fuller form has beyond its special case ``x`` hold the null values.

        Not where the special case loses so much that its fit, or the interval, cannot be right.
        """
        if self.judge.gain(x, best).gain > self.limits.found_nats:
            return False
        own = set(simpler.free)
        for name in candidate.names:
            for case, table in effect(name).effect.special_cases.items():
                own |= {(name, q) for q in table.values()} if case in simpler.names else set()
        extra = [k for k in candidate.free if k not in own and not parameter_of(k).is_shape]
        return bool(extra) and not best.fitted.differs(extra)

    def _as_good(self, fuller: Hypothesis, x: Hypothesis) -> bool:
        """Whether a special case may stand in: under the same name where it ties, under another unless beyond doubt."""
        if self.judge.refuted(x, fuller):
            return False
        if x.names == fuller.names:
            return self.judge.tied(fuller, x)
        return not self.judge.gain(x, fuller).exceeds(self.limits.gain_nats, self.limits.gain_sigmas)


def _is_trend_of(trend: Candidate, candidate: Candidate) -> bool:
    """Whether all that ``trend`` frees are trends of what ``candidate`` frees."""
    return all(q.endswith(TREND) and (n, q.removesuffix(TREND)) in candidate.free for n, q in trend.free)


def contained_in(names: Sequence[str]) -> set[str]:
    """Names of effects, and of those that are special cases of them."""
    return {*names, *(case for name in names for case in effect(name).effect.special_cases)}


def _origin(own: ParameterId, fuller: Candidate) -> ParameterId:
    """Parameter of a fuller form that a special case's ``own`` one is; the same where it has no other name there."""
    tables = ((name, effect(name).effect.special_cases.get(own[0], {})) for name in fuller.names)
    return next(((name, table[own[1]]) for name, table in tables if own[1] in table), own)
