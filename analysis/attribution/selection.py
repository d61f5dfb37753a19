"""Which missing effect explains the residuals: greedy, joint, held-out, with everything that does as well.

The rule kept here: an effect is added only when steps it was not fitted on gain beyond doubt and no channel gets
worse; what the data cannot tell apart is reported together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from analysis.attribution.candidates import Candidate, candidates_of, trends_of, unlike
from analysis.attribution.choice import Judge
from analysis.attribution.coarse_search import CoarseSearch, Point, joint_points, subsample
from analysis.attribution.comparison import LogScoreDifference
from analysis.attribution.fit import Fitted, Fitter, parameter_of
from analysis.attribution.hypothesis import Hypothesis, Rejected, SelectionResult
from analysis.residuals.forward_model import ForwardModel, ParameterId, plate_effects
from analysis.residuals.lack_of_fit import plate_ratio_of, rms_standardised
from analysis.residuals.whitening import Whitener
from analysis.thresholds import FROZEN, Thresholds

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

HOPELESS_NATS = 4.0  # a candidate that fits no better than this on the steps it sees is not looked at again
THREADS = 2
MOST_SHAPES = 4  # settings of what shapes an effect that are followed from the best linear gain
REFITS = 3  # of an explanation, from where a larger one has led
SETTLING = 4  # fits with new weights, at most
MOST_DESCENTS, MOST_FITS = 8, 5  # options followed down their landscape, and from there by a full fit
NEAR_NATS, NEAR_PART = 30.0, 0.2  # of the best one's gain: an option farther behind it is left


class StepwiseSelection:
    """Greedy search with a step back.

    Parameters
    ----------
    world, fitter
        The evidence and its fits.
    limits
        Thresholds of the verdict.
    progress
        Called with what is being tried and the fraction done.
    """

    def __init__(
        self, world: ForwardModel, fitter: Fitter, limits: Thresholds = FROZEN, progress: Progress | None = None
    ) -> None:
        self.world, self.fitter, self.limits = world, fitter, limits
        self.progress = progress or (lambda what, part: None)
        self.train = fitter.train
        self.judge = Judge(fitter.train, limits)

    def explain(self, hints_hz: Sequence[float] = ()) -> SelectionResult:
        """Add effects one after the other while held-out steps gain."""
        nothing = Whitener.of(self.world, {})
        before = self._judged((), self._settled(self.fitter.fit(nothing, (), {})))
        best, rounds, tried = before, [], []
        pool = candidates_of(self.world, hints_hz or self.world.evidence.hints_hz)
        rivals: list[Hypothesis] = []
        refused: list[Rejected] = []
        chain = [before]
        for depth in range(self.limits.most_effects):
            if depth and self._quiet(best):
                rounds.append(f"round {depth + 1}: what is left is no more than noise")
                break
            options = pool if depth == 0 else self._remaining_candidates(pool, best) + trends_of(best.free)
            found = self._round(best, options, depth)
            if depth == 0:
                tried = [
                    (x.candidates[-1].names, LogScoreDifference.of(before.per_step, x.per_step, self.train))
                    for x in found
                ]
            accepted, best = self._accepted(best, found, depth)
            refused += filter(None, [self.judge.rejected(best, found, depth, accepted)])
            if accepted is None:
                rounds.append(f"round {depth + 1}: nothing more gains beyond doubt")
                break
            gain = LogScoreDifference.of(best.per_step, accepted.per_step, self.train)
            added = " + ".join(accepted.candidates[-1].names)
            rounds.append(f"round {depth + 1}: {added} gains {gain.gain:.0f} +- {gain.error:.0f} nats")
            kept = self._simplified(self._step_back(accepted, rounds), pool, rounds)
            rivals = found if kept is accepted else []
            best = self._refined(kept)
            chain.append(best)
        ties = self._ties(before, best, rivals)
        if best is not before:
            best = self._refit_without_excess(best)
            ties = (best, *ties[1:])
        left = [x for x in refused if not set(x.names) <= set(best.names)]
        rejected = max(left, key=lambda x: x.gain, default=None)
        return SelectionResult(before, best, ties, tuple(tried), tuple(rounds), rejected, tuple(chain[:-1]))

    def _quiet(self, best: Hypothesis) -> bool:
        """Whether so little is left that a further effect could only fit noise."""
        values = best.fitted.values
        landings = rms_standardised(self.world, values, self.world.uncertainty(values))
        return (
            landings < self.limits.noise_like_ratio
            and plate_ratio_of(self.world, values) < self.limits.noise_like_ratio
        )

    def _accepted(
        self, best: Hypothesis, found: Sequence[Hypothesis], depth: int
    ) -> tuple[Hypothesis | None, Hypothesis]:
        """What is chosen, and the explanation without it, fitted again from there.

        A fit that had stopped short would let any other effect look needed.
        """
        for _ in range(REFITS):
            chosen = self.judge.choose(best, found, depth)
            if chosen is None:
                return None, best
            start = {k: v for k, v in chosen.fitted.values.items() if k in best.free or k in self.fitter.priors}
            again = self._judged(best.candidates, self._settled(self.fitter.fit(chosen.whitener, best.free, start)))
            if not LogScoreDifference.of(best.per_step, again.per_step, self.train).gain > HOPELESS_NATS:
                return chosen, best
            best = again
        return self.judge.choose(best, found, depth), best

    def _refined(self, x: Hypothesis) -> Hypothesis:
        """Fitted once more from where it stands: slopes of calibrations are those of where a fit began.

        Where a calibration and an effect trade places, a fit that came from far stops short, sure of itself.
        """
        return self._judged(x.candidates, self._settled(self.fitter.fit(x.whitener, x.free, x.fitted.values)))

    def _refit_without_excess(self, x: Hypothesis) -> Hypothesis:
        """The final explanation fitted as if it left nothing over, where the data like that better.

        A fit's own misses count as excess, with which it may be content. Only the last fit is made so: while candidates
        are compared, all are fitted alike.
        """
        lean = self.fitter.fit(Whitener.of(self.world, x.fitted.values, lean=True), x.free, x.fitted.values)
        better = (
            self._profile_loss(x.whitener, lean.values)
            < self._profile_loss(x.whitener, x.fitted.values) - HOPELESS_NATS
        )
        return self._judged(x.candidates, lean) if better else x

    def _judged(self, chosen: tuple[Candidate, ...], fitted: Fitted) -> Hypothesis:
        whitener = Whitener.of(self.world, fitted.values)
        return Hypothesis(chosen, fitted, whitener, fitted.held_out(whitener))

    def _round(self, best: Hypothesis, options: Sequence[Candidate], depth: int) -> list[Hypothesis]:
        """Every option added to the best, those that could not gain left out; the kernel runs free of the lock."""
        done = 0
        far_off = best.whitener.lost
        near = {"parameter_drift", *plate_effects()}
        far = [c for c in options if far_off and not set(c.names) <= near]
        share = 1.0 / max(len(options) + 2 * len(far), 1)

        def told(candidate: Candidate) -> None:
            nonlocal done
            done += 1
            self.progress(" + ".join(candidate.names), (depth + done * share) / self.limits.most_effects)

        def one(candidate: Candidate) -> Hypothesis | None:
            found = self.add(best, candidate)
            told(candidate)
            return found

        with ThreadPoolExecutor(THREADS) as pool:
            found = [x for x in pool.map(one, options) if x is not None]
            return found + (self._searched(best, far, pool, told) if far else [])

    def _searched(
        self,
        best: Hypothesis,
        options: Sequence[Candidate],
        pool: ThreadPoolExecutor,
        told: Callable[[Candidate], None],
    ) -> list[Hypothesis]:
        """The most promising options where landings are missed by far, each from the best place on its landscape."""
        values = best.fitted.values
        land = CoarseSearch(subsample(self.world, self.train), values, self.train)

        def look(candidate: Candidate) -> tuple[float, Point, Candidate]:
            free = tuple(k for k in candidate.free if k not in best.free)
            loss, point = land.lowest(joint_points(candidate.starts, free, best.free), 1)[0]
            told(candidate)
            return loss, {**{k: values[k] for k in best.free}, **point}, Candidate(candidate.names, free)

        def descend(seen: tuple[float, Point, Candidate]) -> tuple[float, Point, Candidate]:
            loss, point = land.descend(seen[1], (*seen[2].free, *best.free))
            told(seen[2])
            return loss, point, seen[2]

        seen = sorted((x for x in pool.map(look, options) if x[2].free), key=lambda x: x[0])[:MOST_DESCENTS]
        below = sorted(pool.map(descend, seen), key=lambda x: x[0])
        enough = below[0][0] + max(NEAR_NATS, NEAR_PART * (land.loss({}) - below[0][0]))
        taken = [x for x in below if x[0] <= enough][:MOST_FITS]
        return list(pool.map(lambda x: self._fitted_from(best, x[1], x[2]), taken))

    def _fitted_from(self, best: Hypothesis, point: Point, candidate: Candidate) -> Hypothesis:
        start = {**best.fitted.values, **point}
        fitted = self.fitter.fit(Whitener.of(self.world, start), (*best.free, *candidate.free), start)
        return self._judged((*best.candidates, candidate), self._settled(fitted))

    def add(self, best: Hypothesis, candidate: Candidate) -> Hypothesis | None:
        """Fit the best explanation with one candidate more; None where the candidate could change nothing here."""
        taken = set(best.free)
        free = tuple(k for k in candidate.free if k not in taken)
        if not free:
            return None
        listed = self._starts(best, candidate, free)
        promised, led = self._promised(best, candidate, free)
        starts = sorted([*listed, *led], key=lambda pair: pair[0])
        level = self._profile_loss(best.whitener, best.fitted.values)
        ahead = level - starts[0][0]
        added = (*best.candidates, Candidate(candidate.names, free))
        cheap = set(candidate.names) <= plate_effects()  # plate data alone: nothing has to be predicted anew
        if ahead >= HOPELESS_NATS:
            begun = [p for _, p in ((listed[0], starts[0]) if cheap and led else unlike(starts, free, absent=cheap))]
            fits = [self._from(best, (*best.free, *free), p) for p in begun]
            return self._judged(added, min(fits, key=lambda x: self._profile_loss(best.whitener, x.values)))
        if not cheap and promised < HOPELESS_NATS:
            return None
        fitted = self.fitter.fit(best.whitener, (*best.free, *free), starts[0][1], best.fitted.slopes)
        gained = max(best.fitted.loss - fitted.loss, level - self._profile_loss(best.whitener, fitted.values))
        if gained < HOPELESS_NATS:
            return Hypothesis(added, fitted, best.whitener, fitted.held_out(best.whitener))
        return self._judged(added, self._settled(fitted))

    def _from(self, best: Hypothesis, free: Sequence[ParameterId], start: Mapping[ParameterId, float]) -> Fitted:
        """Fit from a start, from soft weights to sharp ones."""
        soft = self.fitter.fit(best.whitener, free, start)
        at_start, after = (self._profile_loss(best.whitener, v) for v in (start, soft.values))
        return self._settled(self.fitter.fit(Whitener.of(self.world, start), free, start) if at_start < after else soft)

    def _settled(self, fitted: Fitted) -> Fitted:
        """Fit again with the weights of the point found, until they stay."""
        for _ in range(SETTLING):
            before, after = fitted.state.whitener, Whitener.of(self.world, fitted.values)
            if after.near(before):
                break
            fitted = self.fitter.fit(after, fitted.free, fitted.values)
        return fitted

    def _starts(
        self, best: Hypothesis, candidate: Candidate, free: Sequence[ParameterId]
    ) -> list[tuple[float, dict[ParameterId, float]]]:
        """The candidate's starting points with the loss at each, lowest first.

        Where predictions have to be made anew and something shapes the effect, linear steps lead farther: see
        `_promised`.
        """
        values = best.fitted.values
        starts = candidate.starts or ({},)
        if any(parameter_of(k).shape for k in free) and not set(candidate.names) <= plate_effects():
            starts = starts[:1]
        points = [{**values, **{k: v for k, v in point.items() if k in free}} for point in starts]
        return sorted(((self._profile_loss(best.whitener, p), p) for p in points), key=lambda pair: pair[0])

    def _promised(
        self, best: Hypothesis, candidate: Candidate, free: Sequence[ParameterId]
    ) -> tuple[float, list[tuple[float, dict[ParameterId, float]]]]:
        """What the candidate would gain if residuals were linear in it, and starts on the way there, with their loss.

        An effect that a shape parameter bends is tried in each of its shapes; the most promising ones are followed.
        """
        bent = [k for k in free if parameter_of(k).shape]
        if not bent:
            return self.fitter.linear_step(best.fitted, free)[0], []
        shapes = {tuple(p.get(k, parameter_of(k).absent) for k in bent) for p in candidate.starts}
        steps = [self.fitter.linear_step(best.fitted, free, dict(zip(bent, at, strict=True))) for at in shapes]
        steps.sort(key=lambda pair: -pair[0])
        if steps[0][0] < HOPELESS_NATS:
            return steps[0][0], []
        here = {k: best.fitted.values.get(k, parameter_of(k).absent) for k in steps[0][1]}
        points = [
            {k: v if k in bent else part * v + (1.0 - part) * here[k] for k, v in point.items()}
            for _, point in steps[:MOST_SHAPES]
            for part in (1.0, 0.5, 0.25)
        ]
        return steps[0][0], [(self._profile_loss(best.whitener, p), p) for p in points]

    def _profile_loss(self, whitener: Whitener, values: Mapping[ParameterId, float]) -> float:
        return whitener.profile_loss(self.world.residuals(values), self.world.evidence.plate, self.train)

    def _remaining_candidates(self, pool: Sequence[Candidate], best: Hypothesis) -> list[Candidate]:
        """What has not been named yet, and fuller forms of what has."""
        taken, names = set(best.free), set(best.names)
        own = {name: {k for k in taken if k[0] == name} for name in names}
        return [
            c for c in pool
            if not set(c.names) & names or (len(c.names) == 1 and own[c.names[0]] and own[c.names[0]] < set(c.free))
        ]  # fmt: skip

    def _step_back(self, best: Hypothesis, rounds: list[str]) -> Hypothesis:
        """Leave out an earlier effect that the later ones have made idle."""
        for candidate in best.candidates[:-1]:
            rest = tuple(c for c in best.candidates if c is not candidate)
            free = tuple(k for c in rest for k in c.free)
            start = {k: v for k, v in best.fitted.values.items() if k not in candidate.free}
            x = self._judged(rest, self.fitter.fit(best.whitener, free, start))
            loss = LogScoreDifference.of(x.per_step, best.per_step, self.train)
            if not loss.beyond(self.limits.tie_nats, self.limits.tie_sigmas):
                rounds.append(f"step back: {' + '.join(candidate.names)} is no longer needed")
                return x
        return best

    def _simplified(self, best: Hypothesis, pool: Sequence[Candidate], rounds: list[str]) -> Hypothesis:
        """A special case in place of a cause, unless the fuller form is better beyond doubt.

        A fit of the special case may have stopped short when it was tried: it begins where the fuller form stands.
        """
        for i, candidate in enumerate(best.candidates):
            for simpler in pool:
                if len(simpler.free) >= len(candidate.free) or not set(simpler.names) <= _relatives(candidate.names):
                    continue
                x = self._in_place(best, i, simpler)
                if self._as_good(best, x):
                    rounds.append(f"step back: a simpler {' + '.join(simpler.names)} does as well")
                    return x
        return best

    def _in_place(self, best: Hypothesis, i: int, simpler: Candidate) -> Hypothesis:
        """The explanation with its ``i``-th candidate replaced by a special case of it, fitted."""
        candidate = best.candidates[i]
        chosen = (*best.candidates[:i], simpler, *best.candidates[i + 1 :])
        known = {k: v for k, v in best.fitted.values.items() if k not in candidate.free or k in simpler.free}
        points = [{**point, **known} for point in (*simpler.starts, _reduced(best.fitted.values, simpler.free))]
        start = min(points, key=lambda point: self._profile_loss(best.whitener, point))
        free = tuple(k for c in chosen for k in c.free)
        return self._judged(chosen, self._settled(self.fitter.fit(best.whitener, free, start)))

    def _as_good(self, fuller: Hypothesis, x: Hypothesis) -> bool:
        """Whether a special case may stand in: under the same name where it ties, under another unless beyond doubt."""
        if x.names == fuller.names:
            return self.judge.tied(fuller, x)
        return not self.judge.gain(x, fuller).beyond(self.limits.gain_nats, self.limits.gain_sigmas)

    def _ties(self, before: Hypothesis, best: Hypothesis, rivals: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
        """The best and every rival as good as it that is not the same motion with an idle parameter."""
        if best is before:
            return ()
        out = [best]
        z_best, _ = best.whitener.white(self.world.residuals(best.fitted.values))
        for x in sorted(rivals, key=lambda r: float(r.per_step[self.train].sum())):
            if x is best or x.names in [t.names for t in out] or not self.judge.tied(best, x):
                continue
            z, _ = best.whitener.white(self.world.residuals(x.fitted.values))
            same = float(np.sqrt(np.median((z - z_best) ** 2))) < self.limits.idle
            if len(x.free) > len(best.free) and same and set(best.names) <= _relatives(x.names):
                continue
            out.append(x)
        return tuple(out)


def _reduced(values: Mapping[ParameterId, float], free: Sequence[ParameterId]) -> dict[ParameterId, float]:
    """Where a special case begins: friction of any speed at what remains of it at high speed."""
    kinetic = values.get(("stribeck_friction", "mu_kinetic"), 0.0)
    return {k: kinetic if k[0] == "coulomb_friction" else values.get(k, parameter_of(k).absent) for k in free}


def _relatives(names: Sequence[str]) -> set[str]:
    """Names that a set of names contains as special cases of its members."""
    out = set(names)
    if "stribeck_friction" in out:
        out.add("coulomb_friction")
    return out
