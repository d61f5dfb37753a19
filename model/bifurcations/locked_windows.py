"""The windows of gamma of cycles that never stick.

Without restitution every locked cycle begins at the edge at which a landing meets a threshold, and its family is
followed from there in the phase ``after`` the threshold at which its first flight leaves; gamma is solved for. So a
fold is an ordinary point of the walk, and every end is the root of a smooth function of one number: multiplier = -1
(period doubling), multiplier = +1 (fold), or the two halves of the cycle meeting (the period doubling of the cycle of
half the length, seen from the other side). With restitution there is no such place: locked cycles are met by running
orbits and followed from where they were met (`model.bifurcations.continuation`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from model.bifurcations.continuation import follow_both_ways
from model.bifurcations.itinerary_windows import Window
from model.orbits.attractor import attractor
from model.orbits.exact_ball import ExactBall

Point = tuple[bool, float, float, float, int]
"""What `model.orbits.cycles.locked_family_of` returns: ok, miss, multiplier, half, code."""

Family = Callable[[float, float, int], Point]
"""Maps ``(gamma, after, n)`` to the point of the family of ``n`` flights."""

End = Literal["period doubling", "fold", "merged", "itinerary"]

ROOT = 1e-15


@dataclass(frozen=True)
class Followed:
    """Locked cycles between ``start`` (where the family begins) and ``end`` in gamma, and what ends it."""

    start: float
    end: float
    how: End


@dataclass(frozen=True)
class _Cycle:
    gamma: float
    multiplier: float
    half: float
    code: int


def follow(point: Family, n: int, start: float) -> Followed | None:
    """Follow the family of ``n`` flights that begins at gamma ``start``; None when none does."""
    ok, miss, _, _, _ = point(start, 0.0, n)
    # no cycle of this family begins at the edge asked about
    if not ok or abs(miss) > 1e-6:
        return None
    # the first cycle that leaves after the threshold, as near to it as Newton finds one
    unit = 1e-9
    first = _solve(point, n, unit, start, 1e-9)
    while first is None and unit > 1e-15:
        unit /= 10.0
        first = _solve(point, n, unit, start, 1e-3 * unit)
    if first is None or first.multiplier == 0.0:
        return None
    # sixteen steps to where the multiplier, 0 at the start, would reach 1 by its first slope
    step = unit / abs(first.multiplier) / 16
    before, here = (0.0, _Cycle(start, 0.0, first.half, first.code)), (unit, first)
    for _ in range(400):
        after = here[0] + step
        # gamma is extrapolated along the walk: at a fold it turns back, while ``after`` goes on
        slope = (here[1].gamma - before[1].gamma) / (here[0] - before[0])
        new = _solve(point, n, after, here[1].gamma + slope * step, slope * step)
        if new is None or new.code != first.code:
            step *= 0.5
            if step < 1e-13:
                return Followed(start, here[1].gamma, "itinerary")
            continue
        end = _end(point, n, here, (after, new))
        if end is not None:
            return Followed(start, *end)
        before, here = here, (after, new)
    return Followed(start, here[1].gamma, "itinerary")


@dataclass(frozen=True)
class _Between:
    """A test of the cycles between two of the walk, as a function of ``after``."""

    point: Family
    n: int
    left: tuple[float, _Cycle]
    right: tuple[float, _Cycle]
    test: Callable[[_Cycle], float]

    def cycle(self, after: float) -> _Cycle:
        for known, cycle in (self.left, self.right):
            if after == known:
                return cycle
        rise = self.right[1].gamma - self.left[1].gamma
        guess = self.left[1].gamma + rise * (after - self.left[0]) / (self.right[0] - self.left[0])
        # a cycle narrower in gamma than doubles resolve may be lost on the way: its neighbour is as near as can be
        return _solve(self.point, self.n, after, guess, 0.1 * rise) or self.left[1]

    def __call__(self, after: float) -> float:
        return self.test(self.cycle(after))


def _end(point: Family, n: int, left: tuple[float, _Cycle], right: tuple[float, _Cycle]) -> tuple[float, End] | None:
    """What happens between two cycles of the walk, and at which gamma."""
    tests: list[tuple[End, Callable[[_Cycle], float]]] = [
        ("period doubling", lambda c: c.multiplier + 1.0),
        ("merged", lambda c: c.half),
        ("fold", lambda c: c.multiplier - 1.0),
    ]
    for how, test in tests:
        # the two halves pass a whole turn as well: there their distance jumps, and does not vanish
        a, b = test(left[1]), test(right[1])
        if math.isnan(a) or not a * b <= 0.0 or (how == "merged" and abs(a) + abs(b) > 1.0):
            continue

        if how == "merged":  # there the long cycle's equation has a double root: the short cycle's is solved instead
            return _doubling_between(point, n // 2, left, right) or left[1].gamma, how
        between = _Between(point, n, left, right, test)
        return between.cycle(brentq(between, left[0], right[0], xtol=ROOT, rtol=4 * ROOT)).gamma, how
    return None


def _doubling_between(point: Family, n: int, left: tuple[float, _Cycle], right: tuple[float, _Cycle]) -> float | None:
    """Where the cycle of ``n`` flights that lies between two points of its doubled cycle's walk has multiplier -1."""
    width = right[0] - left[0]
    ends = []
    # the short cycle's take-off is followed a width farther: its doubling may lie just past the long one's points
    for after in (max(left[0] - width, 0.0), right[0] + width):
        cycle = _solve(point, n, after, left[1].gamma, 1e-3 * width)
        if cycle is None:
            return None
        ends.append((after, cycle))
    between = _Between(point, n, ends[0], ends[1], lambda c: c.multiplier + 1.0)
    if between(ends[0][0]) * between(ends[1][0]) > 0.0:
        return None
    return between.cycle(brentq(between, ends[0][0], ends[1][0], xtol=ROOT, rtol=4 * ROOT)).gamma


def _solve(point: Family, n: int, after: float, guess: float, step: float) -> _Cycle | None:
    """The gamma at which the cycle leaves ``after`` the threshold: secant from ``guess``."""
    step = step if step != 0.0 else 1e-12
    old, gamma = guess - step, guess
    ok_old, miss_old, *_ = point(old, after, n)
    if not ok_old:
        old = guess + step
        ok_old, miss_old, *_ = point(old, after, n)
    for _ in range(40):
        ok, miss, multiplier, half, code = point(gamma, after, n)
        if not ok or not ok_old:
            return None
        if miss == 0.0 or abs(gamma - old) <= 2e-16 * gamma:
            return _Cycle(gamma, multiplier, half, int(code))
        if miss == miss_old:
            return _Cycle(gamma, multiplier, half, int(code)) if abs(miss) < 1e-9 else None
        new = gamma - miss * (gamma - old) / (miss - miss_old)
        if not math.isfinite(new) or abs(new - guess) > max(0.05, 100 * abs(step)):
            return None
        old, miss_old, ok_old, gamma = gamma, miss, ok, new
    return _Cycle(gamma, multiplier, half, int(code)) if abs(miss) < 1e-9 else None


def locked_from(ball: ExactBall, window: Window) -> list[Window]:
    """Windows of the locked cycles that begin where the last stick of ``window`` is lost."""
    # a cycle that has two resets keeps one where the other is lost
    if window.resets != 1 or ball.bounces:
        return []
    out = []
    for edge in (window.low, window.high):
        for take_off_window in range(len(ball.take_off_levels[0])):

            def point(gamma: float, after: float, n: int, j: int = take_off_window) -> Point:
                return ball.locked_family(gamma, j, after, n)

            family = follow(point, window.flights, edge)
            if family is not None:
                up = family.end > family.start
                out.append(
                    Window(
                        min(family.start, family.end),
                        max(family.start, family.end),
                        window.flights,
                        0,
                        window.period,
                        0,
                        True,
                        ("", family.how) if up else (family.how, ""),
                    )
                )
    return out


def locked_within(ball: ExactBall, stretches: list[tuple[float, float]], spacing: float) -> list[Window]:
    """Windows of locked cycles met by sampling the orbits from rest, for a ball that bounces."""
    if not ball.bounces:
        return []
    out: list[Window] = []
    for low, high in stretches:
        count = min(max(int((high - low) / spacing), 1), 64)
        for gamma in low + (np.arange(count) + 0.5) * (high - low) / count:
            if any(w.low <= gamma <= w.high for w in out):
                continue
            found = attractor(ball, float(gamma), max_flights=4 * ball.most_flights)
            cycle = ball.close(float(gamma), found.last, found.flights) if found.locked else None
            if cycle is not None:
                branch = follow_both_ways(ball.close, float(gamma), cycle, low, high)
                how = tuple("" if end == "limit" else end for end in branch.ends)
                out.append(Window(branch.low, branch.high, found.flights, 0, cycle.periods, 0, True, (how[0], how[1])))
    return out
