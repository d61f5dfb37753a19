"""What a search for causes comes to: explanations, and which of them stand.

The rule kept here: nothing is decided; these are values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from analysis.attribution.candidates import Candidate
from analysis.attribution.comparison import LogScoreDifference
from analysis.attribution.fit import Fitted
from analysis.residuals.forward_model import ParameterId
from analysis.residuals.whitening import Whitener

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hypothesis:
    """A set of candidates, fitted and judged.

    Attributes
    ----------
    candidates
        In the order in which they were added.
    fitted
        The joint fit.
    whitener
        Uncertainties at the fitted point.
    losses
        Held-out loss by channel, (m,).
    """

    candidates: tuple[Candidate, ...]
    fitted: Fitted
    whitener: Whitener
    losses: Mapping[str, Array]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all effects, each once, in order."""
        return tuple(dict.fromkeys(n for c in self.candidates for n in c.names))

    @property
    def free(self) -> tuple[ParameterId, ...]:
        """Everything the candidates free."""
        return tuple(k for c in self.candidates for k in c.free)

    @property
    def per_step(self) -> Array:
        """Held-out loss of all channels, (m,)."""
        return np.asarray(sum(self.losses.values()))


@dataclass(frozen=True)
class Rejected:
    """A candidate that gained and was refused.

    Attributes
    ----------
    names
        Effects that it would have added.
    gain, error
        Held-out gain over what it was added to, and its standard error, nats.
    reason
        What forbade it, in words.
    """

    names: tuple[str, ...]
    gain: float
    error: float
    reason: str


@dataclass(frozen=True)
class SelectionResult:
    """The outcome.

    Attributes
    ----------
    before, best
        The declared model alone, and the best explanation found (the same object where nothing is missing).
    ties
        Explanations that the data cannot tell from the best one, the best first.
    tried
        Every candidate of the first round with its gain: the chain of reasoning.
    rounds
        What each round found: names, gain, standard error, accepted or why not.
    rejected
        Of all that was refused although it gained more than what was accepted beside it, the one of greatest gain.
    earlier
        What stood before the last cause was added, from the declared model on.
    """

    before: Hypothesis
    best: Hypothesis
    ties: tuple[Hypothesis, ...]
    tried: tuple[tuple[tuple[str, ...], LogScoreDifference], ...]
    rounds: tuple[str, ...] = field(default=())
    rejected: Rejected | None = None
    earlier: tuple[Hypothesis, ...] = ()
