"""Backward elimination: idle effects left out again, special cases in place of fuller forms."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.attribution.candidates import Candidate
from analysis.attribution.choice import Judge
from analysis.attribution.hypothesis import Hypothesis, Refits
from analysis.attribution.priors import null_value_of, parameter_of
from analysis.residuals.values import TREND, ParameterId
from analysis.residuals.whitening import Whitener
from model.effects.registry import effect


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

    def without_idle(self, best: Hypothesis, rounds: list[str]) -> Hypothesis:
        """The hypothesis without an earlier effect that the later ones have made idle; ``rounds`` gets a line."""
        for candidate in best.candidates[:-1]:
            rest = tuple(c for c in best.candidates if c is not candidate)
            x = self.refits.attempted(rest, self._without, best, candidate, rest)
            if x is None:
                continue
            needed = self.judge.gain(x, best).exceeds(self.limits.tie_nats, self.limits.tie_sigmas)
            if not needed and not self.judge.refuted(x, best):
                rounds.append(f"step back: {' + '.join(candidate.names)} is no longer needed")
                return x
        return best

    def _without(self, best: Hypothesis, candidate: Candidate, rest: tuple[Candidate, ...]) -> Hypothesis:
        """The hypothesis refitted with the ``rest`` of its candidates, without one."""
        start = {k: v for k, v in best.fitted.values.items() if k not in candidate.free}
        free = tuple(k for c in rest for k in c.free)
        return self.refits.scored(rest, self.refits.fitter.fit(best.whitener, free, start))

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
        """The hypothesis with a special case in place of an effect, unless the fuller form is better beyond doubt.

        A fit of the special case may have stopped short when it was tried: it begins where the fuller form stands.
        """
        for i, candidate in enumerate(best.candidates):
            for simpler in pool:
                if len(simpler.free) >= len(candidate.free) or not set(simpler.names) <= contained_in(candidate.names):
                    continue
                x = self.refits.attempted((simpler,), self._in_place, best, i, simpler)
                if x is None:
                    continue
                if self._as_good(best, x) or self._extra_is_null(best, x, candidate, simpler):
                    rounds.append(f"step back: a simpler {' + '.join(simpler.names)} does as well")
                    return x
        return best

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
                trends = tuple((n, q + TREND) for (n, q), (m, p) in origins.items() if (m, p + TREND) in c.free)
                if trends:
                    chosen.append(Candidate((trends[0][0], *c.names[1:]), trends, ({},)))
        free = tuple(k for c in chosen for k in c.free)
        origins |= {(n, q + TREND): (m, p + TREND) for (n, q), (m, p) in origins.items()}
        known = {k: v for k, v in values.items() if k not in replaced or k in free}
        reduced = {k: values.get(origins.get(k, k), null_value_of(k)) for k in free}
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
