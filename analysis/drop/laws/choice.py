"""Choice among nested models by held-out log likelihood: the simplest that is not beaten, and those tied with it.

Decisions 121 and 313.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Generic, TypeVar

import numpy as np

from analysis.drop.laws.bounce_law import BounceModel
from analysis.drop.thresholds import CHANCE_LOSS_NATS, HINT_NATS, LEAST_GAIN_NATS, TIE_NATS
from kernels.arrays import Floats, Integers

UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Candidate:
    """A model, fitted to impact times or to a path, and tried on bounces that it was not fitted to."""

    model: BounceModel
    scores: Floats  # (units,) held-out log likelihood of each drop, flight or bounce
    # Root mean square error of flight durations (s or frames), in sample and held out; NaN where there are none.
    rms: float
    held_out_rms: float
    identifiable: bool  # the data can tell the parameters

    LIMITS: ClassVar[Mapping[str, tuple[float, float]]] = {}  # of the parameters, where there are any
    # Units are of different kinds, of which an effect may change some and leave the others: their gains add up.
    ADDED: ClassVar[bool] = False

    def estimates(self) -> dict[str, tuple[float, float]]:
        """Value and half of the 95 % interval of each parameter."""
        raise NotImplementedError

    def intervals(self) -> dict[str, tuple[float, float, float]]:
        """Value, lower and upper end of the 95 % interval of each parameter, inside its limits."""
        found = {}
        for name, (value, half) in self.estimates().items():
            low, high = self.LIMITS.get(name, (-np.inf, np.inf))
            found[name] = (value, max(value - half, low), min(value + half, high))
        return found

    @property
    def significant(self) -> bool:
        """Whether every interval after that of ``e0`` excludes zero; a drag or friction below zero is none."""
        added = {name: numbers for name, numbers in self.estimates().items() if name != "e0"}
        return all(v > half or (name == "e1_s_per_m" and -v > half) for name, (v, half) in added.items())


C = TypeVar("C", bound=Candidate)


@dataclass(frozen=True)
class Verdict(Generic[C]):
    """The models judged."""

    candidates: tuple[C, ...]
    tie_set: tuple[str, ...]  # models that the data cannot distinguish, the best first
    doubts: tuple[str, ...] = ()  # what no model accounts for, in words
    # (drops,) irregular bounces of impact times that were left out
    left_out: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def best(self) -> str:
        """Name of the model that describes the data best."""
        return self.tie_set[0]

    @property
    def chosen(self) -> str:
        """The best model's name, or "unexplained" where there are doubts."""
        return UNEXPLAINED if self.doubts else self.best

    def candidate(self, name: str) -> C:
        """The model called ``name``."""
        return next(one for one in self.candidates if one.model.name == name)


def worth_of(residuals: Sequence[Floats]) -> float:
    """Independent samples per sample, from the lag-one correlation of what is left within each flight or fall.

    At most a half: a tracker, or a person who marks a ball, errs alike over several frames, seen or not.
    """
    product = sum(float(one[1:] @ one[:-1]) for one in residuals)
    rho = min(max(product / max(sum(float(one @ one) for one in residuals), 1e-300), 0.0), 0.95)
    return min((1.0 - rho) / (1.0 + rho), 0.5)


def gain_of(rival: Candidate, than: Candidate) -> tuple[float, bool]:
    """Held-out gain of ``rival`` in nats, and whether it is beyond doubt.

    Beyond doubt: above `LEAST_GAIN_NATS`, and either above twice the standard error of the paired gains or shared by
    all units (a long flight weighs more than a short one, so their gains may differ widely and still all agree). Gains
    that add up are beyond doubt where they stay above `LEAST_GAIN_NATS` without the largest of them.
    """
    each = rival.scores - than.scores
    if len(each) < 2:
        return 0.0, False
    gain = float(each.sum())
    if rival.ADDED:
        return gain, gain - float(each.max()) > LEAST_GAIN_NATS
    doubt = 2.0 * float(each.std(ddof=1)) * float(np.sqrt(len(each)))
    agreed = bool(each.min() > -CHANCE_LOSS_NATS)
    return gain, gain > LEAST_GAIN_NATS and (gain > doubt or agreed)


def choose(models: Sequence[Candidate]) -> tuple[str, ...]:
    """Tie set, its first the simplest model that no other beats beyond doubt.

    Only models whose every added parameter excludes zero can be chosen, or beat another. A simpler model stays in the
    tie set unless it is beaten; a richer one joins it where it seems to help.
    """
    able = [m for m in models if m is models[0] or m.significant]
    standing = [m for m in able if not any(gain_of(rival, m)[1] for rival in able if rival is not m)] or [models[0]]
    fewest = min(len(m.model.parameters) for m in standing)
    best = max((m for m in standing if len(m.model.parameters) == fewest), key=lambda m: float(m.scores.sum()))
    tied: list[Candidate] = []
    for rival in sorted((m for m in models if m is not best), key=lambda m: len(m.model.parameters)):
        behind, beaten = gain_of(best, rival)
        if rival.model.nests(best.model):  # richer; a still richer one with the same effect says nothing new
            tie = behind < -HINT_NATS and not any(rival.model.nests(other.model) for other in tied)
        elif best.model.nests(rival.model):
            tie = not beaten
        else:
            helps = rival is models[0] or gain_of(rival, models[0])[0] > HINT_NATS
            tie = not (beaten and behind > TIE_NATS) and helps
        if tie:
            tied.append(rival)
    return (best.model.name, *(rival.model.name for rival in tied))


def stable_choice(choices: Sequence[tuple[str, ...]], order: Sequence[BounceModel]) -> tuple[str, ...]:
    """One tie set from those of all data (the first) and of data short of an impact.

    A model is chosen only if no part of the data that lacks one impact calls for a simpler one; what the others call
    for is tied with it.
    """
    size = {model.name: len(model.parameters) for model in order}
    best = min((ties[0] for ties in choices), key=lambda name: size[name])
    named = dict.fromkeys([*(ties[0] for ties in choices), *choices[0]])
    return (best, *(name for name in named if name != best))
