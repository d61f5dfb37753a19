"""Choice among nested models by held-out log likelihood: the simplest that is not beaten, and those tied with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.drop.laws.bouncelaw import BounceModel

Array = NDArray[np.float64]

LEAST_GAIN_NATS = 3.0
CHANCE_LOSS_NATS = 0.5
HINT_NATS = 1.0  # held out, by which an effect seems to help without being beyond doubt
TIE_NATS = 6.0  # a model of other parameters is out only this far behind
UNEXPLAINED = "unexplained"


class Scored(Protocol):
    """A fitted candidate model."""

    @property
    def model(self) -> BounceModel:
        """Name and parameters."""
        ...

    @property
    def scores(self) -> Array:
        """Held-out log likelihood of each unit, (units,)."""
        ...

    @property
    def significant(self) -> bool:
        """Whether the interval of every parameter beside ``e0`` excludes zero."""
        ...


def gain_of(rival: Scored, than: Scored) -> tuple[float, bool]:
    """Held-out gain of ``rival`` in nats, and whether it is beyond doubt.

    Beyond doubt: above `LEAST_GAIN_NATS`, and either above twice the standard error of the paired gains or shared by
    all units (a long flight weighs more than a short one, so their gains may differ widely and still all agree).
    """
    each = rival.scores - than.scores
    if len(each) < 2:
        return 0.0, False
    gain = float(each.sum())
    doubt = 2.0 * float(each.std(ddof=1)) * float(np.sqrt(len(each)))
    agreed = bool(each.min() > -CHANCE_LOSS_NATS)
    return gain, gain > LEAST_GAIN_NATS and (gain > doubt or agreed)


def choose(models: Sequence[Scored]) -> tuple[str, tuple[str, ...]]:
    """Name of the simplest model that no other beats beyond doubt, and the tie set, the chosen one first.

    Only models whose every added parameter excludes zero can be chosen, or beat another. A simpler model stays in the
    tie set unless it is beaten; a richer one joins it where it seems to help.
    """
    able = [m for m in models if m is models[0] or m.significant]
    standing = [m for m in able if not any(gain_of(rival, m)[1] for rival in able if rival is not m)] or [models[0]]
    fewest = min(len(m.model.parameters) for m in standing)
    best = max((m for m in standing if len(m.model.parameters) == fewest), key=lambda m: float(m.scores.sum()))
    return best.model.name, (best.model.name, *ties_of(models, best))


def ties_of(models: Sequence[Scored], best: Scored) -> list[str]:
    """Other models that the data cannot tell from ``best``."""
    ties: list[str] = []
    tied: list[Scored] = []
    for rival in sorted((m for m in models if m is not best), key=lambda m: len(m.model.parameters)):
        behind, beaten = gain_of(best, rival)
        helps = gain_of(rival, models[0])[0] > HINT_NATS or rival is models[0]
        if rival.model.nests(best.model):
            tie = behind < -HINT_NATS and not any(rival.model.nests(t.model) for t in tied)
        elif best.model.nests(rival.model):
            tie = not beaten
        else:
            tie = not (beaten and behind > TIE_NATS) and helps
        if tie:
            tied.append(rival)
            ties.append(rival.model.name)
    return ties


def stable_choice(choices: Sequence[tuple[str, tuple[str, ...]]], order: Sequence[BounceModel]) -> tuple[str, ...]:
    """One tie set, the chosen model first, from the choices on all data and on data short of an impact.

    A model is chosen only if no part of the data that lacks one impact calls for a simpler one; what the others call
    for is tied with it.
    """
    size = {model.name: len(model.parameters) for model in order}
    names = [name for name, _ in choices]
    fewest = min(size[name] for name in names)
    best = next(name for name in names if size[name] == fewest)
    rest = [tie for name, ties in choices for tie in (name, *ties) if tie != best]
    kept = dict.fromkeys(names[i] for i in range(len(names)) if names[i] != best)
    kept.update(dict.fromkeys(choices[0][1]))
    return (best, *(name for name in kept if name != best and name in rest))
