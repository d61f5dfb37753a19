"""The windows of gamma of cycles that never stick.

Without restitution every locked cycle begins at the edge at which a landing meets a threshold, where its multiplier is
0: the orbit that just does not stick any more is all but on it. With restitution there is no such place: locked cycles
are met by running orbits. Either is followed from there (`model.bifurcations.continuation`).
"""

from __future__ import annotations

import numpy as np

from model.bifurcations.continuation import follow
from model.bifurcations.itinerary_windows import Window
from model.orbits.attractor import LockedCycle, State, attractor
from model.orbits.exact_ball import ExactBall

BEYOND = 1e-9  # an edge, where the locked cycle that begins there is looked for


def locked_from(ball: ExactBall, window: Window, low: float, high: float) -> list[Window]:
    """Windows within ``low`` and ``high`` of the locked cycles that begin where ``window`` loses its last stick."""
    # a cycle that has two resets keeps one where the other is lost
    if window.resets != 1 or ball.bounces:
        return []
    out = []
    for edge, limit, beyond in ((window.low, low, -BEYOND), (window.high, high, BEYOND)):
        gamma = edge + beyond
        path = ball.fly(edge, State(), ball.most_flights)
        if not low < gamma < high or path.first < 0:
            continue
        resets = path.phase[path.first :][path.reset[path.first :]]
        # from a little before the threshold the ball waits for it, and its last landing is on the cycle
        near = ball.fly(gamma, State(float(resets[0]) - 1e-6), window.flights).last
        cycle = ball.close(gamma, near, window.flights)
        if cycle is not None and cycle.periods == window.period and abs(cycle.multiplier) < 1.0:
            end, why = follow(ball.close, gamma, cycle, limit, BEYOND)  # its window may be as narrow as 1e-7
            how = "" if why in ("limit", "grazing") else why  # what a landing does there, its itinerary tells
            ends = (edge, end, ("", how)) if beyond > 0.0 else (end, edge, (how, ""))
            out.append(_window(cycle, *ends))
    return out


def locked_within(ball: ExactBall, stretches: list[tuple[float, float]], spacing: float) -> list[Window]:
    """Windows of locked cycles met by sampling the orbits from rest, for a ball that bounces."""
    if not ball.bounces:
        return []
    out: list[Window] = []
    for low, high in stretches:
        count = min(max(int((high - low) / spacing), 1), 64)
        for gamma in (low + (np.arange(count) + 0.5) * (high - low) / count).tolist():
            if any(w.low <= gamma <= w.high for w in out):
                continue
            found = attractor(ball, gamma, max_flights=4 * ball.most_flights)
            cycle = ball.close(gamma, found.last, found.flights) if found.locked else None
            if cycle is not None:
                ends = [follow(ball.close, gamma, cycle, limit) for limit in (low, high)]
                below, above = ("" if how == "limit" else how for _, how in ends)
                out.append(_window(cycle, ends[0][0], ends[1][0], (below, above)))
    return out


def _window(cycle: LockedCycle, low: float, high: float, how: tuple[str, str]) -> Window:
    return Window(low, high, cycle.tau.size, 0, cycle.periods, 0, True, how)
