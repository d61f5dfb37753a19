"""The windows of gamma of cycles that never stick.

Without restitution every locked cycle begins where a landing meets a threshold, and its family is
followed from there (`model.bifurcations.locked_family`); with restitution there is no such place, and locked cycles are
met by running orbits and followed from where they were met (`model.bifurcations.continuation`).
"""

from __future__ import annotations

import numpy as np

from model.bifurcations import locked_family
from model.bifurcations.continuation import follow_both_ways
from model.bifurcations.itinerary_windows import Window
from model.orbits.attractor import attractor
from model.orbits.exact_ball import ExactBall


def locked_from(ball: ExactBall, window: Window) -> list[Window]:
    """Windows of the locked cycles that begin where the last stick of ``window`` is lost."""
    # a cycle that has two resets keeps one where the other is lost
    if window.resets != 1 or ball.bounces:
        return []
    out = []
    for edge in (window.low, window.high):
        for take_off_window in range(len(ball.take_off_levels[0])):

            def point(gamma: float, after: float, n: int, j: int = take_off_window) -> locked_family.Point:
                return ball.locked_family(gamma, j, after, n)

            family = locked_family.follow(point, window.flights, edge)
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
