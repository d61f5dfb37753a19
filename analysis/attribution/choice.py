"""Choice among candidates by held-out steps: acceptance, refusal with its reason, and ties. Decision 92."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.attribution.chance import ChanceGains
from analysis.attribution.comparison import (
    LogScoreDifference,
    chance_refusal,
    gain_refusal,
    penalised_best,
    required_gain,
    tied,
)
from analysis.attribution.hypothesis import Hypothesis, Rejected
from analysis.residuals.lack_of_fit import plate_rms_standardised
from analysis.thresholds import FROZEN, Thresholds
from kernels.arrays import Bools


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

        That refutes it, however much steps differ in how clearly they tell the two apart.
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
        for channel in x.losses:
            change = LogScoreDifference.of(x.losses[channel], best.losses[channel], self.train)
            if change.exceeds(limits.worse_nats, limits.worse_sigmas) and not self._trifling(x, channel, change, gain):
                return f"the {channel} data fit worse with it, by {change.gain:.0f} +- {change.error:.0f} nats"
        if any(c.free and not x.fitted.differs(c.free) for c in x.candidates if c not in best.candidates):
            return "the 95 % intervals of its parameters hold the values at which it does nothing"
        return None if chance is None else chance_refusal(chance.p(x), limits)

    def _trifling(self, x: Hypothesis, channel: str, loss: LogScoreDifference, gain: LogScoreDifference) -> bool:
        """Whether plate data lose a small part of what the events gain and are still noise.

        While events were lost, calibrations could follow the plate's noise; found events hold them.
        """
        if channel != "plate" or loss.gain > self.limits.tolerated_plate_loss * gain.gain:
            return False
        return plate_rms_standardised(x.model, x.fitted.values) < self.limits.noise_like_ratio

    def choose(
        self, best: Hypothesis, found: Sequence[Hypothesis], depth: int, chance: ChanceGains | None = None
    ) -> Hypothesis | None:
        """The candidate of lowest held-out loss that passes; of those that tie with it, that of lowest penalised loss.

        The penalty counts its parameters and the prior of the calibrations that it moves. A candidate that leaves more
        than noise, and would need a second cause beside it, comes after those that do not.
        """
        ranked = sorted(found, key=lambda x: float(x.per_step[self.train].sum()))
        passing = (x for x in ranked if self.refusal(best, x, depth, chance) is None)
        top = next(passing, None)
        if top is None:
            return None
        after = ranked[ranked.index(top) + 1 :]  # what chance does is drawn for those alone that could be chosen
        close = [top, *(x for x in after if self.tied(top, x) and self.refusal(best, x, depth, chance) is None)]
        if len(close) > 1:
            close = [x for x in close if x.noise_like(self.limits.noise_like_ratio)] or close
        costs = [x.fitted.prior_penalty + self.limits.tie_nats * len(x.free) for x in close]
        return close[penalised_best(top.per_step, [x.per_step for x in close], costs, self.train)]

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
        for x in sorted(found, key=lambda x: float(x.per_step[self.train].sum())):
            gain = self.gain(best, x)
            if not gain.gain > max(least, self.limits.reported_nats):
                break
            reason = self.refusal(best, x, depth, chance)
            if reason is not None:
                return Rejected(x.candidates[-1].names, gain.gain, gain.error, reason)
        return None
