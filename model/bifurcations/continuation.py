"""Cycles that never stick, stable or not, followed in gamma, or in any one parameter, to where they end.

A cycle is followed by Newton from the cycle before, never by running the orbit; a period doubling is the root of
``multiplier + 1``, a fold that of ``(1 - multiplier)^2``, which is straight where the multiplier itself has a vertical
slope. The branches behind a bifurcation diagram begin by Newton from many phases at seed gammas; each is followed both
ways through every change of stability, to where it meets the edge of a take-off window, a fold or a graze.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from kernels.arrays import Floats
from model.flight.branches import TWO_PI
from model.flight.numerics import FrictionRestitution
from model.orbits.attractor import Ball, Close, LockedCycle, State, doubling_near, state_of

End = Literal["period doubling", "merged", "fold", "grazing", "limit"]


def next_cycle(close: Close, parameter: float, cycle: LockedCycle) -> LockedCycle | None:
    """The same cycle at another parameter; None when Newton finds none or a different one."""
    new = close(parameter, state_of(cycle), cycle.tau.size)
    if new is None or new.periods != cycle.periods:
        return None
    # a flight time that changes by 0.3 rad in one step belongs to another cycle, whichever flight either begins with
    return new if any(np.max(np.abs(np.roll(new.tau, k) - cycle.tau)) < 0.3 for k in range(new.tau.size)) else None


def follow(close: Close, at: float, cycle: LockedCycle, limit: float, step: float = 1e-4) -> tuple[float, End]:
    """Follow a stable ``cycle``, known at the parameter ``at``, to where it ends or to ``limit``, and what ends it."""
    direction = 1.0 if limit > at else -1.0
    trail = [(at, cycle)]
    while True:
        here, known = trail[-1]
        target = here + direction * step
        if direction * (target - limit) > 0.0:
            target = limit
        new = next_cycle(close, target, known)
        # a stable cycle doubles where its multiplier passes -1, and meets its unstable twin (a fold) where it passes 1
        if new is not None and new.multiplier <= -1.0:
            return _doubling(close, trail[-1], (target, new)), "period doubling"
        if new is None or new.multiplier >= 1.0:
            step *= 0.25
            # nearer by quarters: at a graze, the cycle ends without a sign in its multiplier
            if step < 1e-13 * max(1.0, abs(here)):
                return _lost(close, trail)
            continue
        if target == limit:
            return limit, "limit"
        trail = [*trail[-2:], (target, new)]
        step = min(1.5 * step, 2e-2)


def _doubling(close: Close, inside: tuple[float, LockedCycle], outside: tuple[float, LockedCycle]) -> float:
    def test(parameter: float) -> float:
        if parameter == outside[0]:
            return outside[1].multiplier + 1.0
        cycle = next_cycle(close, parameter, inside[1])
        return (cycle or inside[1]).multiplier + 1.0

    return float(brentq(test, inside[0], outside[0], xtol=1e-14, rtol=1e-14))


def _lost(close: Close, trail: Sequence[tuple[float, LockedCycle]]) -> tuple[float, End]:
    """Where and how a cycle ended that cannot be followed any further."""
    here, cycle = trail[-1]
    # at a fold the multiplier goes to 1; a graze ends a cycle of any multiplier
    if cycle.multiplier < 0.8 or len(trail) < 2:
        return here, "grazing"
    n = cycle.tau.size
    # two halves of a cycle as alike as this are about to meet, at the doubling of half the cycle
    if n % 2 == 0 and float(np.max(np.abs(cycle.tau[: n // 2] - cycle.tau[n // 2 :]))) < 0.02:
        half = close(here, state_of(cycle), n // 2)
        # the long cycle has a double root there, the short one a simple one: its doubling is the better equation
        merging = None if half is None else doubling_near(close, here, half, 1e-3)
        if merging is not None:
            return merging[0], "merged"
    # near a fold 1 - multiplier goes with the root of the distance: its square is a straight line to zero
    before, old = trail[-2]
    a, b = (1.0 - old.multiplier) ** 2, (1.0 - cycle.multiplier) ** 2
    return (here if a == b else here + b * (here - before) / (a - b)), "fold"


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
