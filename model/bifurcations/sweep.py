"""Bifurcations of any ball as a bench meets them, in order.

A bench steps gamma, finds the attractor, and bisects a change. The state is carried from step to step (a sweep, with
its hysteresis) or each step starts from rest; where the change is a period doubling it is then solved for by its own
equation. Decision 10.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kernels.errors import InputError
from model.orbits.attractor import AT_REST, Attractor, Ball, State, attractor, doubling_near
from model.orbits.make_ball import IntegratedBall

STEPS = 600  # of a sweep
LONGEST = 32  # flights of the longest cycle looked for
TYPES = frozenset(("take-off", "rest", "period doubling", "lock", "stick lost", "stick gained")) | frozenset(
    ("flight lost", "flight gained", "jump")
)
"""Every type of change that a sweep reports."""


@dataclass(frozen=True)
class Side:
    """The cycle on one side of a bifurcation; all None where none of those looked for is there."""

    period: int | None = None
    flights: int | None = None
    resets: int | None = None


@dataclass(frozen=True)
class Bifurcation:
    """One change of the attractor: where in gamma, its type, and the cycles just below and above.

    ``type`` is one of: ``take-off``, ``new take-off window``, ``take-off windows merge``, ``lock`` (a cycle with a
    reset stops sticking, or a locked 1-cycle is born at a fold), ``stick lost``, ``stick gained``, ``flight lost``,
    ``flight gained`` (one of zero length, at the end of a take-off window), ``grazing`` (a landing jumps), ``period
    doubling``, ``fold``, ``accumulation``, ``basin`` (the orbit from rest goes to another cycle; neither changes).
    """

    gamma: float
    type: str
    before: Side
    after: Side


def check_range(low: float, high: float) -> None:
    """Refuse a range of gamma that is empty, negative or not finite (ValueError)."""
    if not (math.isfinite(low) and math.isfinite(high) and 0.0 <= low < high):
        raise InputError(f"gamma must range from a smaller to a larger number, neither negative, not {low} to {high}")


def observed_bifurcations(
    ball: Ball,
    low: float,
    high: float,
    *,
    sweep: str | None = None,
    steps: int = STEPS,
    narrowest: float = 1e-6,
    sharp: float = 0.0,
) -> Iterator[Bifurcation]:
    """Changes of the attractor between ``low`` and ``high`` in the order met; searched no farther than they are taken.

    Raises `ValueError` if the range is empty, negative or not finite.

    Parameters
    ----------
    sweep
        ``"up"`` or ``"down"``: the state is carried, and `before` and `after` follow the sweep; None: each gamma from
        rest, upwards.
    steps
        Gammas looked at; a window narrower than a step is met by chance.
    narrowest
        Width in gamma down to which windows between two changes in one step are found.
    sharp
        Width in gamma to which a change is bisected, where less will do than the ball allows.
    """
    check_range(low, high)
    ends = (high, low) if sweep == "down" else (low, high)
    exact = not isinstance(ball, IntegratedBall)
    # coarser for a ball whose integration has a tolerance
    finest = max(sharp, 1e-12 if exact else 1e-9)

    def look(gamma: float, start: State) -> Attractor:
        return attractor(ball, gamma, AT_REST if sweep is None else start, 2048)

    # each orbit of such a ball costs an integration: a quarter of the steps
    grid = np.linspace(*ends, (steps if exact else steps // 4) + 1)
    here = look(float(grid[0]), AT_REST)
    for a, b in pairwise(grid):
        start, at = float(a), here
        # more than eight changes in one step are the cascade before chaos: its end is what counts
        for _ in range(8):
            end = look(float(b), at.last)
            if key(end) == key(at):
                break
            gamma, past, left, right = _bisect(look, start, float(b), at, finest)
            # what comes and goes within the narrowest window counts as one change
            ahead = past + math.copysign(min(narrowest, abs(b - past)), b - a)
            after = look(ahead, right.last)
            if key(after) != key(at):
                yield _typed(ball, gamma, left, after)
            start, at = ahead, after
            if abs(b - start) <= narrowest:
                break
        here = look(float(b), at.last)


def key(found: Attractor) -> tuple[object, ...]:
    """What makes two attractors look different; of a chatter not how many of its bounces were flown one by one."""
    if _irregular(found):
        return ("irregular",)
    flights = found.flights if found.kind == "periodic" else 0
    return found.kind, found.period, found.resets, found.locked, flights


def _bisect(
    look: Callable[[float, State], Attractor], a: float, b: float, at: Attractor, finest: float
) -> tuple[float, float, Attractor, Attractor]:
    """The first change met from ``a`` towards ``b``: gamma, the first gamma beyond, and both attractors."""
    left, right = at, look(b, at.last)
    while abs(b - a) > finest:
        middle = 0.5 * (a + b)
        found = look(middle, left.last)
        if key(found) == key(at):
            a, left = middle, found
        else:
            b, right = middle, found
    return 0.5 * (a + b), b, left, right


def _typed(ball: Ball, gamma: float, left: Attractor, right: Attractor) -> Bifurcation:
    before, after = _side(left), _side(right)
    if left.flights == 0 or right.flights == 0:
        return Bifurcation(gamma, "take-off" if left.flights == 0 else "rest", before, after)
    if left.locked and right.locked and 2 in (_ratio(left, right), _ratio(right, left)):
        # the shorter cycle's multiplier passes -1 there: an equation, where bisection sees only which attractor won
        short = left if _ratio(left, right) == 2 else right
        cycle = ball.close(gamma, State(short.last.phase, short.last.speed), short.flights)
        exact = None if cycle is None else doubling_near(ball.close, gamma, cycle, 1e-3)
        return Bifurcation(gamma if exact is None else exact[0], "period doubling", before, after)
    if left.resets and right.locked:
        return Bifurcation(gamma, "lock" if left.flights == right.flights else "stick lost", before, after)
    if left.locked and right.resets:
        return Bifurcation(gamma, "stick gained", before, after)
    if left.resets != right.resets and not (_irregular(left) or _irregular(right)):
        return Bifurcation(gamma, "stick lost" if left.resets > right.resets else "stick gained", before, after)
    if abs(left.flights - right.flights) == 1 and left.period == right.period:
        return Bifurcation(gamma, "flight lost" if left.flights > right.flights else "flight gained", before, after)
    return Bifurcation(gamma, "jump", before, after)


def _ratio(one: Attractor, other: Attractor) -> float:
    return other.flights / one.flights


def _irregular(found: Attractor) -> bool:
    """Chaotic, or a cycle so long that no bench tells it from chaos."""
    return found.kind == "chaotic" or found.flights > LONGEST


def _side(found: Attractor) -> Side:
    if _irregular(found):
        return Side()
    return Side(found.period, found.flights, found.resets)
