"""Stepwise selection of missing effects: forward by held-out gain, with backward elimination and a set of ties.

An effect is added only when steps that its fit did not see gain beyond doubt and no channel gets worse. What the data
do not distinguish is reported together.

References
----------
A. Miller, Subset Selection in Regression, 2nd ed. (Chapman & Hall, 2002), chapter 3: stepwise selection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.attribution.candidates import Candidate, beyond, candidates_of, parameter_of
from analysis.attribution.chance import ChanceGains, best_by_chance, generator_of, probability
from analysis.attribution.choice import Judge, LogScoreDifference, Pruning, contained_in
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import ChanceTest, Hypothesis, Refits, Rejected, Scatter, remaining_candidates
from analysis.attribution.proposals import Progress, Proposals
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.thresholds import FROZEN, MOVED_SIGMAS, NEAR_CAUSE, Thresholds
from model.effects.registry import ball_effects, effect, trend_name


@dataclass(frozen=True)
class SelectionResult:
    """Result of a stepwise selection."""

    before: Hypothesis  # the declared model
    best: Hypothesis  # the best hypothesis found, the same object where nothing is missing
    ties: tuple[Hypothesis, ...]  # hypotheses that the data do not distinguish from the best one, the best first
    tried: tuple[tuple[tuple[str, ...], LogScoreDifference], ...]  # every candidate of the first round with its gain
    # outcome of each round: names, gain, standard error, accepted or why not
    rounds: tuple[str, ...] = field(default=())
    # of all that was refused although it gained more than what was accepted in its place, the one of greatest gain
    rejected: Rejected | None = None
    chance: tuple[ChanceTest, ...] = ()  # by round, the best candidate against chance
    scatter: Scatter | None = None  # of the restitution from impact to impact, where it is a cause
    earlier: tuple[Hypothesis, ...] = ()  # hypotheses before the last effect was added, from the declared model on


@dataclass(frozen=True)
class _Round:
    """The last round that added an effect: what it added to, the rivals of that, and the gain, held against chance."""

    before: Hypothesis
    rivals: list[Hypothesis]
    gain: LogScoreDifference
    depth: int
    null: ChanceGains


class StepwiseSelection:
    """Forward stepwise selection with backward elimination.

    Parameters
    ----------
    model, fitter
        The observations and their fits.
    limits
        Thresholds of the verdict.
    progress
        Called with what is being tried and the fraction done.
    library
        Candidates to choose from; `candidates_of` the model where not given.
    """

    def __init__(
        self,
        model: ForwardModel,
        fitter: Fitter,
        limits: Thresholds = FROZEN,
        progress: Progress | None = None,
        library: Sequence[Candidate] | None = None,
    ) -> None:
        self.model, self.fitter, self.limits = model, fitter, limits
        self.progress = progress or (lambda what, part: None)
        self.library = candidates_of(model) if library is None else list(library)
        self.judge = Judge(fitter.train, limits)
        self.refits = Refits(fitter, anew=False)
        self.proposals = Proposals(self.refits, limits)
        self.pruning = Pruning(self.refits, self.judge)

    def declared(self) -> Hypothesis:
        """The declared model with no effect added."""
        return self.refits.converged((), Whitener.of(self.model, {}), (), {})

    def run(self) -> SelectionResult:
        """The result of all rounds; what could not be fitted is left out of it, by name.

        A cause of last resort goes where the others explain as much with as few numbers.
        """
        found, failed = self._chosen(), sorted(self.refits.failed.items())
        rare = {name for name in found.best.names if effect(name).effect.last_resort}
        if rare and found.best.passes(self.limits):
            library = [c for c in self.library if not rare & set(c.names)]
            ordinary = StepwiseSelection(self.model, self.fitter, self.limits, self.progress, library)._chosen()
            found = min(ordinary, found, key=lambda r: (not r.best.passes(self.limits), r.best.numbers))
        left_out = (f"{' + '.join(names)} left out: {why}" for names, why in failed)
        return replace(found, rounds=(*found.rounds, *left_out))

    def _chosen(self) -> SelectionResult:
        before, data = self.declared(), self.model.observations.plate
        mains = self._mains(before) if data.mains.any() else []
        results = [] if mains else [self._freely_chosen(before)]
        if data.on_mains.size and not (mains or results[0].best.passes(self.limits)):
            mains = self._mains(before)
        for x in mains:
            if results and results[-1].best.passes(self.limits):
                break
            found = self._identified(x)
            results.append(self._followed(before, found or mains, min(found, key=self.judge.loss, default=x))[0])
        return min(results, key=lambda r: (not r.best.passes(self.limits), self.judge.loss(r.best)))

    def _mains(self, before: Hypothesis) -> list[Hypothesis]:
        """The mains in the cable, and in the plate, which move all flights of a step alike on a forcing's multiple."""
        size = {parameter_of(k).hook: c for c in self.library if len(c.free) == 1 for k in c.free}
        options = [size[hook] for hook in ("pickup_mps2", "hum_mps2") if hook in size]
        return [x for c in options if (x := self.refits.attempted((c,), self.proposals.add, before, c)) is not None]

    def _freely_chosen(self, before: Hypothesis) -> SelectionResult:
        """Rounds that begin with what gains most.

        Of two causes at once a third effect may gain more than either alone, and no step leads from there to both.
        Where the first choice would end unexplained, the best one of another name is followed as well.
        """
        found = self._identified(before)
        taken, first = self._followed(before, found) if found else (None, ())
        if taken is None or not first:
            found = self._round(before, self.library, 0)
            taken, first = self._followed(before, found)
        others = [x for x in found if not contained_in(x.names) & contained_in(first)]
        if not others or not first or taken.best.passes(self.limits):
            return taken
        other, _ = self._followed(before, others)
        lead = self.judge.gain(taken.best, other.best)
        beyond_doubt = lead.exceeds(self.limits.next_effect_nats, self.limits.next_effect_sigmas)
        if not beyond_doubt and not self.judge.refuted(taken.best, other.best):
            return taken
        instead = (
            f"{' + '.join(first)}, chosen first, leaves more than noise; what follows foretells held-out steps better "
            f"by {lead.gain:.0f} nats"
        )
        return replace(other, tried=taken.tried, rounds=(instead, *other.rounds))

    def _identified(self, before: Hypothesis) -> list[Hypothesis]:
        """What recorded volts show without a flight is added first: a cause is then sought over the plate as it is."""
        known = {name for name, _ in self.fitter.identified}
        options = [c for c in self.library if known and set(c.names) <= known]
        found = list[Hypothesis]()
        for c in sorted(options, key=lambda c: len(c.free)):
            case = next((x for x in found if beyond(x.candidates[-1], c)), None)
            fit = self.proposals.add if case is None else self.proposals.extended
            found += filter(None, [self.refits.attempted((c,), fit, case or before, c)])
        return found

    def _followed(
        self, before: Hypothesis, found: list[Hypothesis], given: Hypothesis | None = None
    ) -> tuple[SelectionResult, tuple[str, ...]]:
        """The result of the rounds that begin with the choice among ``found`` or ``given``; the names chosen first."""
        best, rounds, rivals, tried = before, list[str](), list[Hypothesis](), found
        refused, chance = list[Rejected](), list[ChanceTest]()
        first: tuple[str, ...] = ()
        rng, chain = generator_of(self.model), [before]
        last: _Round | None = None
        near: dict[str, list[Hypothesis]] = {}  # by the cause that was chosen, others that gained nearly as much
        for depth in range(6):  # twice as many as effects on the ball: instruments and plate may have as many
            if self._ball_effects(best) == self.limits.most_effects:
                break
            if depth and best.noise_like(self.limits.noise_like_ratio) and not best.strained:
                rounds.append(f"round {depth + 1}: what is left is no more than noise")
                break
            options = remaining_candidates(self.library, best) if depth else self.library
            if depth:
                others = [self._special_case(best, found), self._rival(best, found)]
                found = self._round(best, options, depth)
                for x in filter(None, others):
                    found += self._round(x, remaining_candidates(self.library, x, best.names), depth)
            accepted, null = None if depth else given, ChanceGains(best, options, rng)
            if accepted is None:
                accepted, best, null = self._accepted(best, found, depth, null)
            if accepted is not None and self._is_in_place_of_a_cause(best, accepted, found, depth):
                steady = [x for x in found if len(x.candidates) == len(accepted.candidates) - 1]
                accepted = self.judge.choose(best, steady, depth, null)
            refused += filter(None, [self.judge.rejected(best, found, depth, accepted, null)])
            chance += filter(None, [null.test(accepted, found, self.limits.best_of_all_p)])
            if accepted is None:
                rounds.append(f"round {depth + 1}: nothing more gains beyond doubt{best_by_chance(chance, depth)}")
                break
            gain = self.judge.gain(best, accepted)
            first = first or accepted.candidates[-1].names
            rounds.append(f"round {depth + 1}: {_gained(best, accepted, gain, chance[-1], accepted is given)}")
            last = _Round(best, rivals, gain, depth, null)
            near[accepted.candidates[-1].names[0]] = [
                x for x in found if self.judge.gain(best, x).gain > NEAR_CAUSE * gain.gain
            ]
            kept = self.pruning.without_idle(accepted, accepted.candidates[:-1], rounds)
            # a step back changes what the round's other hypotheses were added to: they are no rivals any more
            rivals = found if kept is accepted else []
            if kept is accepted:  # a cause and its drift are confirmed one by one
                chain += [x for x in found if x.candidates == accepted.candidates[:-1] != best.candidates][:1]
            best = self.refits.again(kept)
            chain.append(best)
        best, rivals = self._simplest(best, rivals, last, rounds)
        # an effect may have been needed only while others were missing; where all are gone, nothing explains nothing
        best, exchanged = self._exchanged(self.pruning.without_null(best, rounds), rounds, near, retried=not rivals)
        best = self._fullest(best, rounds)
        chain = [*(x for x in chain[:-1] if x is not best), best := best if best.candidates else before]
        ties = self._ties(before, best, [*rivals, *exchanged])
        if best is not before:
            best = self.pruning.without_excess(best)
            ties = (best, *ties[1:])
        strongest = max((x for x in refused if not set(x.names) <= set(best.names)), key=lambda x: x.gain, default=None)
        gains = tuple((x.candidates[-1].names, self.judge.gain(before, x)) for x in tried)
        earlier = tuple(chain[:-1])
        return SelectionResult(before, best, ties, gains, tuple(rounds), strongest, tuple(chance), None, earlier), first

    def _ball_effects(self, found: Hypothesis) -> int:
        """How many effects flights have to tell; what instruments and recorded volts show does not count."""
        known = {name for name, _ in self.fitter.identified}
        return len(ball_effects({n: {} for n in found.names if n not in known}))

    def _round(
        self, best: Hypothesis, options: Sequence[Candidate], depth: int, rival: Hypothesis | None = None
    ) -> list[Hypothesis]:
        most, say = self.limits.most_effects, self.progress
        return self.proposals.round(best, options, lambda name, x: say(name, min((depth + x) / most, 1.0)), rival)

    def _is_in_place_of_a_cause(
        self, best: Hypothesis, accepted: Hypothesis, found: Sequence[Hypothesis], depth: int
    ) -> bool:
        """Whether a drift was added with a cause, and a second cause beside that does as well.

        Where a second cause is missing, a drift may stand in for it; in the round that adds both it has no rival.
        """
        cause = next((x for x in found if x.candidates == accepted.candidates[:-1] != best.candidates), None)
        if cause is None or self.judge.refusal(best, cause, depth):
            return False
        others = [c for c in remaining_candidates(self.library, cause) if trend_name() not in c.names]
        second = min(self._round(cause, others, depth, accepted), key=self.judge.loss, default=None)
        return second is not None and self.judge.tied(accepted, second)

    def _special_case(self, best: Hypothesis, found: Sequence[Hypothesis]) -> Hypothesis | None:
        """Of a round the best hypothesis with a special case in place of the one that was added; None without one.

        A fuller form may stand in for its special case and a second cause; no step leads from there to both of them.
        """
        last = best.candidates[-1].names
        cases = contained_in(last) - set(last)
        same = [x for x in found if x.candidates[:-1] == best.candidates[:-1] and set(x.candidates[-1].names) <= cases]
        return min(same, key=self.judge.loss, default=None)

    def _rival(self, best: Hypothesis, found: Sequence[Hypothesis]) -> Hypothesis | None:
        """Of a round the best hypothesis as good as the one chosen there, where a calibration plays a further cause.

        Which of them is right may show only with that cause.
        """
        same = [x for x in found if x.candidates[:-1] == best.candidates[:-1] and x.names != best.names]
        rival = min(same, key=self.judge.loss, default=None)
        return rival if rival is not None and best.strained and self.judge.tied(best, rival) else None

    def _accepted(
        self, best: Hypothesis, found: Sequence[Hypothesis], depth: int, null: ChanceGains
    ) -> tuple[Hypothesis | None, Hypothesis, ChanceGains]:
        """The choice of a round, the hypothesis without it, fitted again from there, and the chance beside that.

        A fit that had stopped short would let any other effect look needed.
        """
        refitted = None
        for _ in range(3):
            chosen = self.judge.choose(best, found, depth, null)
            if chosen is None or chosen is refitted:  # from the same start to the same fit
                return chosen, best, null
            refitted = chosen
            start = {k: v for k, v in chosen.fitted.values.items() if k in best.free or k in self.fitter.priors}
            again = self.refits.attempted(
                best.candidates, self.refits.converged, best.candidates, chosen.whitener, best.free, start
            )
            if again is None or not self.judge.gain(best, again).gain > self.limits.negligible_nats:
                return chosen, best, null
            best, null = again, null.of_refit(again)
        return self.judge.choose(best, found, depth, null), best, null

    def _simplest(
        self, best: Hypothesis, rivals: list[Hypothesis], last: _Round | None, rounds: list[str]
    ) -> tuple[Hypothesis, list[Hypothesis]]:
        """The simplest form of a hypothesis that does as well, and its rivals, when all causes are named.

        While a cause is missing, it may hide what a fuller form has beyond its special case. The last effect goes where
        its gain is small and the simpler form fails the tests: it was another form that had passed them. An effect that
        only the fuller form needed goes, too.
        """
        kept = self.pruning.simplified(best, self.library, rounds)
        if last is None or kept is best:
            return best, rivals
        clear = last.gain.exceeds(self.limits.next_effect_nats, self.limits.next_effect_sigmas)
        if (
            not clear
            and kept.names == best.names
            and (why := self.judge.refusal(last.before, kept, last.depth, last.null))
        ):
            rounds.append(f"step back: that simpler form is refused ({why})")
            return last.before, last.rivals
        simple = self.refits.again(kept)
        return self.pruning.without_idle(simple, simple.candidates if len(simple.names) > 1 else (), rounds), []

    def _fullest(self, best: Hypothesis, rounds: list[str]) -> Hypothesis:
        """The hypothesis with fuller forms of its effects from which no step back would lead to these.

        What was stepped back to may have another one than it came from, and less is asked of it than of another cause.
        """
        for c in remaining_candidates(self.library, best):
            for own in (x for x in best.candidates if x.names == c.names and set(x.free) < set(c.free)):
                case = replace(best, candidates=(*(x for x in best.candidates if x is not own), own))
                x = self.refits.attempted((c,), self.proposals.extended, case, c)
                if x is not None and not self.pruning.does_as_well(case, x, c, own):
                    rounds.append(f"a fuller {c.names[0]} gains {self.judge.gain(best, x).gain:.0f} nats")
                    return self._fullest(x, rounds)
        return best

    def _exchanged(
        self, best: Hypothesis, rounds: list[str], near: Mapping[str, Sequence[Hypothesis]], *, retried: bool
    ) -> tuple[Hypothesis, list[Hypothesis]]:
        """The hypothesis with a cause exchanged for another that does as well with less, and its rivals.

        An earlier cause was chosen while a later one was missing, or with one that was taken back: it is tried against
        others that came ``near`` it, and against calibrations that the fit moved far. So is the last one against what
        tied with it, if the others are simpler now (``retried``). Of ties the one that leaves calibrations is named.
        """
        moved, close = best.fitted.moved_calibrations(MOVED_SIGMAS), [best]
        for own in [c for c in best.candidates if len(c.names) == 1]:
            rest = tuple(c for c in best.candidates if c is not own)
            if any(set(own.names) & set(c.names) for c in rest):  # its drift, or a second form
                continue
            others = [(c, best.fitted.values) for c in self.library if set(c.free) <= moved]
            last = own is best.candidates[-1]
            rivals = near.get(own.names[0], ()) if retried or not last else ()
            others += [(x.candidates[-1], x.fitted.values) for x in rivals if not last or self.judge.tied(best, x)]
            for c, values in others:
                if len(c.names) > 1 or set(c.names) & set(best.names):
                    continue
                free = tuple(k for x in (*rest, c) for k in x.free)
                known = {k: v for k, v in best.fitted.values.items() if k in best.free and k not in own.free}
                start = known | {k: values[k] for k in c.free if k in values}
                x = self.refits.attempted((*rest, c), self.refits.converged, (*rest, c), best.whitener, free, start)
                if x is not None and self.judge.tied(best, x) and not self.judge.refuted(x, best):
                    close.append(x)
        chosen = self.judge.cheapest(close)
        if chosen is not best:
            gone, new = (set(a.names) - set(b.names) for a, b in ((best, chosen), (chosen, best)))
            rounds.append(f"{' + '.join(new)} in place of {' + '.join(gone)}: as good or better")
            chosen = self.pruning.simplified(chosen, self.library, rounds)
        return chosen, [x for x in close if x is not chosen]

    def _ties(self, before: Hypothesis, best: Hypothesis, rivals: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
        """The best and every rival as good as it that is not the same motion with an idle parameter."""
        if best is before:
            return ()
        out = [best]
        # both in the weights of the best one: motions are compared, not weights
        z_best, _ = best.whitener.white(self.model.residuals(best.fitted.values))
        for x in sorted(rivals, key=self.judge.loss):
            if x is best or x.names in [t.names for t in out] or not self.judge.tied(best, x):
                continue
            if self.judge.refuted(x, best):
                continue
            z, _ = best.whitener.white(self.model.residuals(x.fitted.values))
            same = float(np.sqrt(np.median((z - z_best) ** 2))) < self.limits.idle_rms
            if len(x.free) > len(best.free) and same and set(best.names) <= contained_in(x.names):
                continue
            out.append(x)
        return tuple(out)


def _gained(best: Hypothesis, accepted: Hypothesis, gain: LogScoreDifference, test: ChanceTest, shown: bool) -> str:
    """What an accepted hypothesis adds, replaces and gains, in words; ``shown``: recorded volts show it or its like."""
    added, gone = accepted.candidates[-1].names, [name for name in best.names if name not in accepted.names]
    words = " + ".join(added)
    if gone:
        words = f"{' + '.join(n for n in accepted.names if n not in best.names)} in place of {' + '.join(gone)}"
    by_chance = f"{probability(test)} that the best of all candidates does so by chance"
    why = "recorded volts show it or its like" if shown else by_chance
    return f"{words} gains {gain.gain:.0f} +- {gain.error:.0f} nats ({why})"
