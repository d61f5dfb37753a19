"""Cycles of many parameter points in one compiled call: flights, resets, period and flight times.

The orbits are those of `model.orbits.ideal_cycles` and `model.orbits.friction_cycles`; a row that does not close is
left to `model.orbits.attractor`, which knows locked cycles and chaos.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from model.flight.branches import fold
from model.flight.numerics import Floats, compiled
from model.flight.records import FrictionRestitution
from model.orbits import friction_cycles, ideal_cycles
from model.orbits.cycles import CHATTERS, FLIGHTS, PERIOD, RESETS, Flown, Integers

CHATTERING = 3  # column of the outcome: the cycle holds a completed chatter
OUTCOME_SIZE = 4


@compiled
def _keep_cycle(flown: Flown, first: int, stop: int, outcome: Integers, kept: Floats) -> None:
    """Write a cycle's outcome, and its flight times from the reset with the smallest phase on."""
    start = first
    for k in range(first, stop):
        if flown.threshold[k] >= 0:
            outcome[RESETS] += 1
            if fold(flown.phase[k], 0.0) < fold(flown.phase[start], 0.0):
                start = k
        if flown.mark[k] & CHATTERS:
            outcome[CHATTERING] = 1
    outcome[FLIGHTS] = stop - first
    for k in range(min(stop - first, kept.shape[0])):
        j = start + k
        kept[k] = flown.tau[j if j < stop else j - (stop - first)]


def _batch_of(from_rest: Callable[..., Any]) -> Callable[..., None]:
    """The kernel of one kind of ball, whose orbits ``from_rest`` flies."""

    @compiled
    def cycle_batch(
        tones: Floats, turning: Floats, gammas: Floats, laws: Floats, flown: Flown, outcome: Integers, kept: Floats
    ) -> None:
        """Fill ``outcome`` (m, OUTCOME_SIZE; FLIGHTS -1 where the orbit did not close) and ``kept`` (m, keep).

        ``laws`` (m, 4) holds ``mu_up, mu_down, e0, e1``.
        """
        outcome[:] = 0
        kept[:] = math.nan
        for row in range(gammas.shape[0]):
            law = FrictionRestitution(laws[row, 0], laws[row, 1], laws[row, 2], laws[row, 3])
            lifts, first, stop, periods = from_rest(tones, turning, gammas[row], law, flown)
            outcome[row, PERIOD] = periods if lifts and first >= 0 else 1
            if lifts and first < 0:
                outcome[row, FLIGHTS] = -1
            elif lifts:
                _keep_cycle(flown, first, stop, outcome[row], kept[row])

    return cycle_batch


ideal_batch = _batch_of(ideal_cycles.from_rest)
friction_batch = _batch_of(friction_cycles.from_rest)
