"""Proposals of a round of the selection: every candidate fitted on top of the best hypothesis so far.

Candidates that cannot gain are dropped before their fit. Where landings are lost, the most promising ones are also
looked for over the whole range of what switches the ball's behaviour.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from analysis.attribution.candidates import (
    Candidate,
    Point,
    beyond,
    distinct_starts,
    names_in,
    null_value_of,
    parameter_of,
    trends_of,
    within,
)
from analysis.attribution.coarse_search import CoarseSearch, axes_of, coarse_grids, subsample
from analysis.attribution.fit import Fitted, Fitter
from analysis.attribution.hypothesis import Hypothesis, Refits
from analysis.computing import THREADS
from analysis.linear_algebra import NotFiniteError
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import TREND, ParameterId, plate_effects
from analysis.thresholds import DRIFTING_NATS, FOLLOWED_PART, NEAR_NATS, NEAR_PART, Thresholds
from model.effects.registry import effect, trend_name

Tried = Callable[[Candidate], None]
Progress = Callable[[str, float], None]
Found = TypeVar("Found", bound=tuple[Any, ...])  # a loss and what has it

MOST_SWITCHED = 3  # sizes from which a ball that rebounds a little is sought
SQUARED_HOOKS = frozenset({"harmonics", "hum_mps2", "pickup_mps2"})  # of plate data without a slope at the null value
PARTS = (1.0, 0.5, 0.25)  # of a linear step, at which its loss is looked up until it has half of its promise
KEPT_PROMISE = 0.5  # part of a linear gain below which a fit is led on with new slopes of the calibrations


def has_shape(free: Sequence[ParameterId]) -> bool:
    """Whether one of the parameters only shapes an effect."""
    return any(parameter_of(k).is_shape for k in free)


class Proposals:
    """Fits of candidates on top of the best hypothesis so far.

    Parameters
    ----------
    refits
        How hypotheses are fitted.
    limits
        Thresholds of the verdict.
    """

    def __init__(self, refits: Refits, limits: Thresholds) -> None:
        self.refits, self.fitter, self.limits = refits, refits.fitter, limits

    @cached_property
    def _ahead(self) -> Proposals | None:
        """The same for a few of the flights of each step; None where there are not many more."""
        model, train, enough = self.refits.model, self.refits.train, 400  # flights tell what gains hundreds of nats
        if np.sum(model.observations.scored) < 3 * enough:
            return None
        few = subsample(model, np.ones_like(train), enough)
        return Proposals(Refits(Fitter(few, self.fitter.priors, train), anew=False), self.limits)

    def round(
        self, best: Hypothesis, options: Sequence[Candidate], progress: Progress, rival: Hypothesis | None = None
    ) -> list[Hypothesis]:
        """Each option that may gain, fitted on top of `best`.

        Where much more than noise is left in many flights, a few of them tell which options could win: only these are
        fitted to all of them, from where they stand, the others led one step on.

        Parameters
        ----------
        best, options
            The hypothesis that is added to, and candidates.
        progress
            Called with a candidate's name and the fraction of the round that is done.
        rival
            Where given, only options are of interest that come near it.
        """
        if self._ahead is None or best.noise_like(2.0):
            return self._round(best, options, progress, rival)
        few, attempted, values = self._ahead.refits, self.refits.attempted, best.fitted.values
        begun = few.fitter.fit(Whitener.of(few.model, values, best.whitener), best.free, values, most=-math.inf)
        found = self._ahead._round(known := few.scored(best.candidates, begun), options, progress, rival)
        gains = [self._ahead._gained(known, x.fitted) for x in found]
        most = max(gains, default=0.0)
        enough = most - max(NEAR_NATS, NEAR_PART * most)

        def in_full(x: Hypothesis, gain: float) -> Hypothesis | None:
            chosen, start = x.candidates, x.fitted.values
            if gain >= enough:
                weights = self.refits.weights(start, best.whitener)
                return attempted(chosen, self.refits.converged, chosen, weights, x.free, start)
            if rival is not None:
                return None
            known = {k: v for k, v in best.fitted.slopes.items() if k not in x.free}
            fitted = attempted(chosen, self.fitter.fit, best.whitener, x.free, start, known, most=-math.inf)
            return None if fitted is None else attempted(chosen, self._as_begun, best, chosen, fitted)

        with ThreadPoolExecutor(THREADS) as pool:
            return [x for x in pool.map(in_full, found, gains) if x is not None]

    def _round(
        self, best: Hypothesis, options: Sequence[Candidate], progress: Progress, rival: Hypothesis | None = None
    ) -> list[Hypothesis]:
        """Fit each option on top of `best` in parallel (the kernel releases the GIL); drop those that cannot gain."""
        flying = [c for c in options if not set(c.names) <= {trend_name(), *plate_effects()}]
        # only a landing that is lost lies on another branch, where no small step from here leads
        far = flying if best.whitener.lost else []
        attempted = self.refits.attempted
        done, total = 0, max(len(options) + 2 * len(far), 1)

        def tried(candidate: Candidate) -> None:
            nonlocal done
            done += 1
            progress(" + ".join(candidate.names), done / total)

        def one(candidate: Candidate) -> Fitted | None:
            found = attempted((*best.candidates, candidate), self._with_weights_of, best, candidate)
            tried(candidate)
            return found

        def followed(begun: tuple[Candidate, Fitted, float], enough: float = -math.inf) -> Hypothesis | None:
            candidate, fitted, gained = begun
            if rival is not None and gained < enough:
                return None
            chosen, fit = self._chosen(best, candidate), self._iterated if gained >= enough else self._as_begun
            return attempted(chosen, fit, best, chosen, fitted)

        def fuller(candidate: Candidate) -> Hypothesis | None:
            cases = [x for x in found if x.whitener is not best.whitener and beyond(x.candidates[-1], candidate)]
            if not cases:
                fitted = one(candidate)
                return None if fitted is None else followed((candidate, fitted, self._gained(best, fitted)), enough)
            tried(candidate)
            # one of another name may have no place here: a pull of any height is none of a magnet's range
            begun = [within(x.fitted.values, x.candidates[-1], candidate) for x in cases]
            least = int(np.argmin([self.refits.profile_loss(best.whitener, values) for values in begun]))
            return attempted((*best.candidates, candidate), self.extended, cases[least], candidate)

        plain = [c for c in options if not any(beyond(case, c) for case in options)]
        with ThreadPoolExecutor(THREADS) as pool:
            soft = [(c, x) for c, x in zip(plain, pool.map(one, plain), strict=True) if x is not None]
            begun = sorted(((c, x, self._gained(best, x)) for c, x in soft), key=lambda x: -x[2])
            found = [x for x in map(followed, begun[:1]) if x is not None]
            if far and not self._settled(found):
                found += self._from_afar(best, far, pool, tried)
            most = max((self._gained(best, x.fitted) for x in found), default=0.0)
            enough = min(FOLLOWED_PART * most, most - NEAR_NATS)
            if rival is not None:
                most = max(most, self._gained(best, rival.fitted))
                enough = most - max(NEAR_NATS, NEAR_PART * most)
            found += [x for x in pool.map(lambda x: followed(x, enough), begun[1:]) if x is not None]
            found += [x for x in list(pool.map(fuller, [c for c in options if c not in plain])) if x is not None]
            gains = any(self._loss(best) - self._loss(x) > self.limits.next_effect_nats for x in found)
            if gains or best.noise_like(self.limits.noise_like_ratio):
                return found + self._drifting(best, found, pool)
            return found + [x for x in pool.map(lambda c: self._switched_on(best, c), flying) if x is not None]

    def _switched_on(self, best: Hypothesis, candidate: Candidate) -> Hypothesis | None:
        """What switches the ball's behaviour, from small sizes with their own weights; None for other candidates.

        A ball that rebounds a little is flown with another uncertainty than one that rests: by the weights of rest the
        truth itself would lose.
        """
        chosen = self._chosen(best, candidate)
        free = chosen[-1].free
        if not any(keys == free for keys, _ in coarse_grids()):
            return None
        starts = [p for _, p in self._starts(best, candidate, free) if any(p[k] != null_value_of(k) for k in free)]

        def from_start(start: Point) -> Hypothesis:
            return self.refits.scored(
                chosen, self.refits.reweighted(self._fitted_sharply(best, (*best.free, *free), start))
            )

        fits = [self.refits.attempted(chosen, from_start, p) for p in starts[:MOST_SWITCHED]]
        return min((x for x in fits if x is not None), key=self._loss, default=None)

    def extended(self, case: Hypothesis, candidate: Candidate) -> Hypothesis | None:
        """A fuller form, fitted from where its special case stands; None where what it has beyond promises nothing."""
        *others, special = case.candidates
        taken = {k for c in others for k in c.free}
        own = names_in(special, candidate)
        extra = tuple(k for k in candidate.free if k not in taken and k not in own.values())
        promised, led = self._linear_gain(case, candidate, extra)
        if promised < self.limits.negligible_nats:
            return None
        chosen = (*others, Candidate(candidate.names, tuple(k for k in candidate.free if k not in taken)))
        free = tuple(k for c in chosen for k in c.free)
        begun = min(led, key=lambda pair: pair[0])[1] if led else case.fitted.values
        start = within(begun, special, candidate)
        known = {k: x for k, x in case.fitted.slopes.items() if k in self.fitter.priors and k not in free}
        fitted = self.fitter.fit(case.whitener, free, start, known)
        return self.refits.scored(chosen, self.refits.reweighted(fitted))

    def _drifting(self, best: Hypothesis, found: Sequence[Hypothesis], pool: ThreadPoolExecutor) -> list[Hypothesis]:
        """The strongest candidates, each with the drift that promises most, where the best one leaves more than noise.

        Without it, a cause that drifts widely loses to another cause that happens to follow the drift.
        """
        strong: dict[tuple[str, ...], Hypothesis] = {}
        for x in sorted(found, key=self._loss):
            if self._loss(best) - self._loss(x) > DRIFTING_NATS:
                strong.setdefault(x.names, x)
        if not strong or next(iter(strong.values())).noise_like(self.limits.noise_like_ratio):
            return []

        def drifting(x: Hypothesis) -> Hypothesis | None:
            fresh = set(x.candidates[-1].free)
            trends = [c for c in trends_of(x.free) if {(n, q.removesuffix(TREND)) for n, q in c.free} <= fresh]
            promised = [(self.fitter.linear_step(x.fitted, c.free)[0], i) for i, c in enumerate(trends)]
            if not promised:
                return None
            trend = trends[max(promised)[1]]
            return self.refits.attempted((*x.candidates, trend), self.add, x, trend)

        return [x for x in pool.map(drifting, list(strong.values())[:4]) if x is not None]

    def _loss(self, x: Hypothesis) -> float:
        """Held-out loss."""
        return float(x.per_step[self.refits.train].sum())

    def _settled(self, found: Sequence[Hypothesis]) -> bool:
        """Whether the best of the fits from nearby has found the lost landings and leaves no more than noise."""
        top = min(found, key=self._loss, default=None)
        return top is not None and not top.whitener.lost and top.noise_like(self.limits.noise_like_ratio)

    def add(self, best: Hypothesis, candidate: Candidate) -> Hypothesis | None:
        """Fit the best hypothesis with one candidate more; None where the candidate could change nothing here.

        Raises `NotFiniteError` where nothing that it predicts is finite.
        """
        fitted = self._with_weights_of(best, candidate)
        return None if fitted is None else self._iterated(best, self._chosen(best, candidate), fitted)

    def _chosen(self, best: Hypothesis, candidate: Candidate) -> tuple[Candidate, ...]:
        """The candidates of the best hypothesis, and what is fresh of one more."""
        return (*best.candidates, Candidate(candidate.names, tuple(k for k in candidate.free if k not in best.free)))

    def _gained(self, best: Hypothesis, fitted: Fitted) -> float:
        """What a fit gains on the training steps, each channel's excess noise at its best, nats."""
        return best.level - self.refits.profile_loss(best.whitener, fitted.values)

    def _iterated(self, best: Hypothesis, chosen: tuple[Candidate, ...], fitted: Fitted) -> Hypothesis:
        """The hypothesis of a fit, its weights iterated where it gains."""
        if max(best.fitted.loss - fitted.loss, self._gained(best, fitted)) < self.limits.negligible_nats:
            return self._as_begun(best, chosen, fitted)
        return self.refits.scored(chosen, self.refits.reweighted(fitted))

    def _as_begun(self, best: Hypothesis, chosen: tuple[Candidate, ...], fitted: Fitted) -> Hypothesis:
        """The hypothesis of a fit with the weights of ``best``."""
        return Hypothesis(chosen, fitted, best.whitener, fitted.held_out(best.whitener))

    def _with_weights_of(self, best: Hypothesis, candidate: Candidate) -> Fitted | None:
        """Fit the best hypothesis with one candidate more by the weights that it has; see `add`."""
        free = self._chosen(best, candidate)[-1].free
        if not free:
            return None
        promised, starts, two = self._begun(best, candidate, free)
        if not math.isfinite(starts[0][0]):
            raise NotFiniteError("what it predicts is not finite")
        if best.level - starts[0][0] >= self.limits.negligible_nats:
            return self._lowest(best, [self._fitted_from(best, (*best.free, *free), p) for _, p in two])
        plate_only = set(candidate.names) <= plate_effects()
        # a power has no slope where its amplitude is 0: the linear gain would be none, whatever the data show
        cheap = plate_only and (not best.free or bool(SQUARED_HOOKS & effect(candidate.names[0]).hooks.keys()))
        if not cheap and promised < self.limits.negligible_nats:
            return None
        # what is fitted already has its slopes here: only the candidate's are taken
        known, everything = {k: x for k, x in best.fitted.slopes.items() if k not in free}, (*best.free, *free)
        fitted = self.fitter.fit(best.whitener, everything, starts[0][1], known)
        if self._gained(best, fitted) > KEPT_PROMISE * promised or promised < self.limits.negligible_nats:
            return fitted
        # a calibration that has taken the effect's place has to go back, along slopes of its own
        return self._lowest(best, [fitted, self.fitter.fit(best.whitener, everything, fitted.values)])

    def _lowest(self, best: Hypothesis, fits: Sequence[Fitted]) -> Fitted:
        """The fit of the lowest loss under the weights of ``best``."""
        return min(fits, key=lambda x: self.refits.profile_loss(best.whitener, x.values))

    def _begun(
        self, best: Hypothesis, candidate: Candidate, free: Sequence[ParameterId]
    ) -> tuple[float, list[tuple[float, Point]], list[tuple[float, Point]]]:
        """What the candidate promises in nats; its starts with the loss at each, lowest first; the two to fit from."""
        listed = self._starts(best, candidate, free)
        promised, led = self._linear_gain(best, candidate, free)
        starts = sorted([*listed, *led], key=lambda pair: pair[0])
        plate_only = set(candidate.names) <= plate_effects()
        if plate_only and led:
            return promised, starts, [listed[0], starts[0]]
        return promised, starts, distinct_starts(starts, free, with_size=plate_only)

    def _starts(self, best: Hypothesis, candidate: Candidate, free: Sequence[ParameterId]) -> list[tuple[float, Point]]:
        """The candidate's starting points with the loss at each, lowest first.

        Where flights have to be predicted and a shape is free, linear steps lead farther: see `_linear_gain`.
        """
        values = best.fitted.values
        starts = candidate.starts or ({},)
        if has_shape(free) and not set(candidate.names) <= plate_effects():
            starts = starts[:1]
        points = [{**values, **{k: v for k, v in point.items() if k in free}} for point in starts]
        return sorted(((self.refits.profile_loss(best.whitener, p), p) for p in points), key=lambda pair: pair[0])

    def _linear_gain(
        self, best: Hypothesis, candidate: Candidate, free: Sequence[ParameterId]
    ) -> tuple[float, list[tuple[float, Point]]]:
        """Gain of the candidate if residuals were linear in it, and starts on the way there, with their loss.

        An effect with shape parameters is tried in each of its shapes; the most promising ones are followed.
        """
        shapes = [k for k in free if parameter_of(k).is_shape]
        if not shapes:
            return self.fitter.linear_step(best.fitted, free)[0], []
        settings = dict.fromkeys(tuple(p.get(k, null_value_of(k)) for k in shapes) for p in candidate.starts)
        steps = [self.fitter.linear_step(best.fitted, free, dict(zip(shapes, at, strict=True))) for at in settings]
        steps.sort(key=lambda pair: -pair[0])
        if steps[0][0] < self.limits.negligible_nats:
            return steps[0][0], []
        here = {k: best.fitted.values.get(k, null_value_of(k)) for k in steps[0][1]}

        def reached(point: Point, part: float) -> Point:
            return {k: v if k in shapes else part * v + (1.0 - part) * here[k] for k, v in point.items()}

        led = list[tuple[float, Point]]()
        for promised, point in steps[:4]:
            for part in PARTS:
                there = reached(point, part)
                led.append((self.refits.profile_loss(best.whitener, there), there))
                if best.level - led[-1][0] > 0.5 * promised:
                    break
        return steps[0][0], led

    def _fitted_from(self, best: Hypothesis, free: Sequence[ParameterId], start: Mapping[ParameterId, float]) -> Fitted:
        """Fit from a start with the weights of ``best``; where that loses, with the sharper ones of the start."""
        known = {k: x for k, x in best.fitted.slopes.items() if k not in free}
        soft = self.fitter.fit(best.whitener, free, start, known)
        at_start, after = (self.refits.profile_loss(best.whitener, v) for v in (start, soft.values))
        return self._fitted_sharply(best, free, start) if at_start < after else soft

    def _fitted_sharply(
        self, best: Hypothesis, free: Sequence[ParameterId], start: Mapping[ParameterId, float]
    ) -> Fitted:
        """Fit from a start with its own weights: what lies far off is followed farther, if it is there."""
        return self.fitter.fit(self.refits.weights(start, best.whitener), free, start)

    def _from_afar(
        self, best: Hypothesis, options: Sequence[Candidate], pool: ThreadPoolExecutor, tried: Tried
    ) -> list[Hypothesis]:
        """The most promising options where landings are lost, each from its minimum on a subsample."""
        values, train = best.fitted.values, self.refits.train
        search = CoarseSearch(subsample(self.refits.model, train), values, train, best.whitener)
        # what was identified without a flight stays where it is: each move of a mode is a motion of the plate anew
        unknown = [k for k in best.free if k not in self.fitter.identified]

        def on_grid(candidate: Candidate) -> tuple[float, Point, Candidate]:
            free = tuple(k for k in candidate.free if k not in best.free)
            jointly = any(keys[0] in free for keys, _ in coarse_grids())  # what switches behaviour itself
            loss, point = search.lowest(axes_of(candidate.starts, free, best.free), jointly=jointly)
            tried(candidate)
            return loss, {**{k: values[k] for k in best.free}, **point}, Candidate(candidate.names, free)

        def minimised(seen: tuple[float, Point, Candidate]) -> tuple[float, Point, Candidate]:
            loss, point = search.minimise(seen[1], (*seen[2].free, *unknown))
            tried(seen[2])
            return loss, point, seen[2]

        def fitted(found: tuple[float, Point, Candidate]) -> tuple[float, tuple[Candidate, ...], Fitted] | None:
            start, chosen = {**values, **found[1]}, (*best.candidates, found[2])
            sharp = self.refits.attempted(chosen, self._fitted_sharply, best, (*best.free, *found[2].free), start)
            return None if sharp is None else (-self._gained(best, sharp), chosen, sharp)

        def iterated(found: tuple[float, tuple[Candidate, ...], Fitted]) -> Hypothesis | None:
            _, chosen, x = found
            return self.refits.attempted(chosen, lambda: self.refits.scored(chosen, self.refits.reweighted(x)))

        def near(ordered: Sequence[Found], level: float) -> Sequence[Found]:
            enough = ordered[0][0] + max(NEAR_NATS, NEAR_PART * (level - ordered[0][0])) if ordered else 0.0
            return [x for x in ordered if x[0] <= enough]

        seen = sorted((x for x in pool.map(on_grid, options) if x[2].free), key=lambda x: x[0])[:8]
        below = sorted(pool.map(minimised, seen), key=lambda x: x[0])
        # a subsample orders candidates only roughly: all that come near the best are fitted in full
        full = [x for x in pool.map(fitted, near(below, search.loss({}))[:5]) if x is not None]
        full.sort(key=lambda x: x[0])
        return [x for x in pool.map(iterated, near(full, 0.0)) if x is not None]
