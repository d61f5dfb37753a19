"""What one explanation gains over another on held-out steps, and how sure that is.

The rule kept here: the step is the replicate, and no few of them decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_OF_A_STEP = 12.0  # nats


@dataclass(frozen=True)
class LogScoreDifference:
    """One explanation against another by the held-out steps.

    Attributes
    ----------
    gain, error
        In nats, with the standard error.
    even, even_error
        The same with no step counting for more than `MOST_OF_A_STEP` either way: a few steps that gain hundreds of nats
        spread the sum without making it doubtful.
    """

    gain: float
    error: float
    even: float
    even_error: float

    @classmethod
    def of(cls, worse: Array, better: Array, train: NDArray[np.bool_]) -> LogScoreDifference:
        """Gain of ``better`` over ``worse``, both losses by step."""
        d = (worse - better)[train]
        return cls(*_sum(d), *_sum(np.clip(d, -MOST_OF_A_STEP, MOST_OF_A_STEP)))

    def beyond(self, nats: float, sigmas: float) -> bool:
        """Whether it is at least so many nats and standard errors, as it is or with each step limited.

        A sum that is small against its own error is doubtful however its steps are limited.
        """
        return self.gain > max(nats, 0.5 * self.error) and (
            self.gain > sigmas * self.error or self.even > max(nats, sigmas * self.even_error)
        )


def penalised_best(top: Array, losses: Sequence[Array], costs: Sequence[float], train: NDArray[np.bool_]) -> int:
    """Which of several explanations that tie does the most for the least.

    Parameters
    ----------
    top
        Losses by step of the one of lowest sum.
    losses, costs
        Of each explanation: losses by step, and what else counts against it, nats. No step counts for more than
        `MOST_OF_A_STEP`.
    train
        Steps that count.
    """
    return int(
        np.argmin([LogScoreDifference.of(x, top, train).even + cost for x, cost in zip(losses, costs, strict=True)])
    )


def _sum(d: Array) -> tuple[float, float]:
    return float(d.sum()), float(np.sqrt(len(d)) * np.std(d, ddof=1)) if len(d) > 1 else np.inf
