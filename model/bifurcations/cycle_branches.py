"""Cycles that never stick, stable or not, over gamma: the branches behind a bifurcation diagram.

At seed gammas Newton begins from many phases; whatever cycle it finds is followed both ways by Newton from the cycle
before, through every change of stability, to where it meets the edge of a take-off window, a fold or a graze.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kernels.arrays import Floats
from model.bifurcations.continuation import next_cycle
from model.flight.branches import TWO_PI
from model.flight.numerics import FrictionRestitution
from model.orbits.attractor import Ball, LockedCycle, State

SEEDS = 24  # phases from which Newton begins, at one gamma
STEP = 0.01  # in gamma


@dataclass(frozen=True)
class CycleBranch:
    """One family of cycles: gamma and multiplier, (m,), take-off phases and flight times, (m, flights)."""

    gamma: Floats
    multiplier: Floats
    phase: Floats
    tau: Floats
    periods: int

    @property
    def flights(self) -> int:
        """Flights of one cycle."""
        return int(self.tau.shape[1])

    def near(self, gamma: float, cycle: LockedCycle) -> bool:
        """Whether ``cycle`` at ``gamma`` is on this branch."""
        if cycle.tau.size != self.flights or not self.gamma[0] <= gamma <= self.gamma[-1]:
            return False
        here = np.array([np.interp(gamma, self.gamma, column) for column in np.unwrap(self.phase, axis=0).T])
        # the same cycle may be entered at another of its flights
        turns = [np.remainder(here - np.roll(cycle.phase, k) + 0.5 * TWO_PI, TWO_PI) for k in range(self.flights)]
        # cycles within 0.02 rad of each other at one gamma are one
        return bool(min(np.max(np.abs(turn - 0.5 * TWO_PI)) for turn in turns) < 0.02)


def cycle_branches(ball: Ball, low: float, high: float, most_flights: int = 2) -> list[CycleBranch]:
    """Every branch of cycles of at most so many flights that passes a seed between gammas ``low`` and ``high``."""
    found: list[CycleBranch] = []
    for gamma in np.linspace(low, high, max(2, round((high - low) / 0.03) + 1)).tolist():
        for cycle in _cycles(ball, gamma, most_flights):
            if not any(branch.near(gamma, cycle) for branch in found):
                found.append(followed(ball, gamma, cycle, low, high))
    return found


def _cycles(ball: Ball, gamma: float, most_flights: int) -> Iterator[LockedCycle]:
    """Cycles that Newton finds at ``gamma``, some of them more than once."""
    e = getattr(ball, "law", FrictionRestitution()).e0
    for n in range(1, most_flights + 1):
        for phase in np.arange(SEEDS) * TWO_PI / SEEDS:
            # off the plate at what is left of the impact of a flight of one period
            cycle = ball.close(gamma, State(float(phase), e * TWO_PI / (1.0 + e)), n)
            if cycle is not None and cycle.periods:
                yield cycle


def followed(ball: Ball, gamma: float, cycle: LockedCycle, low: float, high: float) -> CycleBranch:
    """The branch of ``cycle``, known at ``gamma``, between ``low`` and ``high``."""
    below = list(_walk(ball, gamma, cycle, low))[::-1]
    points = [*below, (gamma, cycle), *_walk(ball, gamma, cycle, high)]
    rows = [np.array([getattr(c, name) for _, c in points]) for name in ("multiplier", "phase", "tau")]
    return CycleBranch(np.array([g for g, _ in points]), rows[0], rows[1], rows[2], cycle.periods)


def _walk(ball: Ball, gamma: float, cycle: LockedCycle, limit: float) -> Iterator[tuple[float, LockedCycle]]:
    """The same cycle from ``gamma`` on towards ``limit``, without the first."""
    sign, step = (1.0 if limit > gamma else -1.0), STEP
    while step > 1e-5 and gamma != limit:
        target = min(gamma + step, limit) if sign > 0.0 else max(gamma - step, limit)
        new = next_cycle(ball.close, target, cycle)
        if new is None:
            step *= 0.25
            continue
        gamma, cycle, step = target, new, min(2.0 * step, STEP)
        yield gamma, cycle
