"""Paired differences of held-out log scores, and the rules of choice that rest on them.

Steps of a run, or runs where many are judged together, are the independent replicates. Each one's contribution is also
counted clipped, so that no few of them decide. Decision 370.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.thresholds import MOST_OF_A_STEP_NATS, Thresholds
from kernels.arrays import Bools, Floats


@dataclass(frozen=True)
class LogScoreDifference:
    """Gain of one hypothesis over another on held-out steps.

    Attributes
    ----------
    gain, error
        In nats, with the standard error.
    clipped, clipped_error
        The same with each step's contribution clipped at `MOST_OF_A_STEP_NATS` either way: a few steps that gain
        hundreds of nats spread the sum without making it doubtful.
    """

    gain: float
    error: float
    clipped: float
    clipped_error: float

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
