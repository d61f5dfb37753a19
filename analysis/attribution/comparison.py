"""Paired differences of held-out log scores.

Steps are the independent replicates. Each step's contribution is also counted clipped, so that no few of them decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.thresholds import MOST_OF_A_STEP_NATS
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
