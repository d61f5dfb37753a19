"""Every change of the cycle reached from rest, as gamma grows: where, of which kind, from which period to which.

Each is located by its own equation. An edge of a window with a reset is where a landing meets a
threshold or the end of a take-off window, or where a graze begins (bisected on whole numbers to neighbouring doubles);
a period doubling or a fold of a locked cycle is the root of its multiplier; a take-off window is born at a maximum of
the forcing; at an accumulation a landing falls on an unstable cycle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from kernels.errors import InputError
from model.bifurcations.itinerary_windows import Window, find_windows
from model.bifurcations.sweep import LONGEST, Bifurcation, Side, check_range, observed_bifurcations
from model.flight.branches import TWO_PI
from model.orbits.attractor import Ball, State
from model.orbits.cycles import FLIGHTS, PERIOD, RESETS
from model.orbits.exact_ball import ExactBall, FrictionBall, IdealBall, Itinerary

MOST_GAMMAS = 20_000_000  # looked at in one search: some minutes
BOUNCING = 1e-3  # default with restitution: most gammas are chaotic there, and a search down to 1e-6 takes minutes
NARROWEST = 1e-6  # default width in gamma of the narrowest window looked for
SAME = 1e-9  # two edges nearer than this are one event


def bifurcations(ball: ExactBall, low: float, high: float, *, narrowest: float = NARROWEST) -> list[Bifurcation]:
    """All bifurcations between ``low`` and ``high`` of the cycle reached from rest, in order.

    Raises `InputError` if the range is empty, negative or not finite.

    Sought are the edges of windows of at least ``narrowest`` in gamma.
    """
    found = cycle_windows(ball, low, high, narrowest=narrowest)
    births, merges = ball.take_off_levels
    levels = {float(g): "new take-off window" for g in births} | {float(g): "take-off windows merge" for g in merges}
    if births.size:
        levels[float(births[0])] = "take-off"
    events = [
        Bifurcation(g, kind, _side_at(ball, g, -1, found), _side_at(ball, g, +1, found))
        for g, kind in levels.items()
        if low <= g <= high
    ]
    cuts = [low, high, *levels]
    events += _edges(ball, found, cuts)
    events += _accumulations(ball, found, cuts)
    return sorted(events, key=lambda e: e.gamma)


def find_bifurcations(
    ball: Ball, low: float, high: float, *, narrowest: float | None = None, sweep: str | None = None
) -> list[Bifurcation]:
    """Bifurcations between ``low`` and ``high`` of the attractor reached from rest, or carried along by ``sweep``.

    Raises `ValueError` if the range is empty, negative or not finite.

    ``narrowest`` is the width in gamma of the narrowest window looked for; None: `NARROWEST`, with restitution
    `BOUNCING`. A sweep and an integrated ball are looked at step by step instead (`model.bifurcations.sweep`).
    """
    if isinstance(ball, IdealBall | FrictionBall) and sweep is None:
        finest = narrowest if narrowest is not None else BOUNCING if ball.bounces else NARROWEST
        return bifurcations(ball, low, high, narrowest=finest)
    return list(observed_bifurcations(ball, low, high, sweep=sweep))


def cycle_windows(ball: ExactBall, low: float, high: float, *, narrowest: float = NARROWEST) -> list[Window]:
    """The windows of gamma, wider than ``narrowest``, with one cycle of at most `LONGEST` flights each, in order.

    Raises `InputError` if the range is empty, negative or not finite.
    """
    check_range(low, high)
    if not narrowest > 0.0:
        raise InputError(f"the narrowest window must be wider than 0, not {narrowest:g}")
    finest = min(narrowest, ball.coarse)
    if not (high - low) <= MOST_GAMMAS * finest:
        raise InputError(
            f"bifurcations from {low:g} to {high:g} down to windows of {finest:g} want {(high - low) / finest:.1e} "
            f"gammas looked at, more than {MOST_GAMMAS:.0e}: ask for a narrower range, or for wider windows "
            "(--narrowest)"
        )
    births, merges = ball.take_off_levels
    levels = [g for g in sorted([*births, *merges]) if low < g < high]
    out: list[Window] = []
    for a, b in zip([low, *levels], [*levels, high], strict=True):
        if not births.size or b <= births[0]:
            continue
        # levels part the range: a window born within a stretch would renumber the symbols that windows are compared by
        out += find_windows(ball, a, b, narrowest, LONGEST)
    return out


def _near(gamma: float, others: Iterable[float]) -> bool:
    return any(abs(gamma - g) < SAME for g in others)


def _edges(ball: ExactBall, windows: list[Window], cuts: list[float]) -> list[Bifurcation]:
    """One event an edge, edges that two windows share taken once; ``cuts`` are no edges of their own."""
    out = []
    ends = sorted([(w.high, w, True) for w in windows] + [(w.low, w, False) for w in windows], key=lambda e: e[0])
    i = 0
    while i < len(ends):
        gamma = ends[i][0]
        here = [e for e in ends[i : i + 2] if e[0] - gamma < SAME]
        # two upper ends, or two lower ones, at one gamma are two edges; only an end and a start are one event
        if len(here) == 2 and here[0][2] == here[1][2]:
            here = here[:1]
        i += len(here)
        if not _near(gamma, cuts):
            left = next((w for _, w, is_high in here if is_high), None)
            right = next((w for _, w, is_high in here if not is_high), None)
            event = _event(ball, gamma, left, right)
            if event.type != "basin" or event.before != event.after:
                out.append(event)
    return out


def _event(ball: ExactBall, gamma: float, left: Window | None, right: Window | None) -> Bifurcation:
    known = (left.how[1] if left is not None else "") or (right.how[0] if right is not None else "")
    # past an edge at which the other side is looked at: doubles, or more where a locked cycle was followed to it
    followed = any(w is not None and w.locked for w in (left, right))
    room = (1e-12 if followed else 8 * np.spacing(1.0)) * max(gamma, 1.0)
    before = _side(left) if left is not None else _side_at(ball, gamma - room, -1, [])
    after = _side(right) if right is not None else _side_at(ball, gamma + room, +1, [])
    if known in ("period doubling", "merged"):
        factor = 2.0 if known == "period doubling" else 0.5
        # a locked cycle or its double may have no window wide enough to be listed: it follows from the other
        if before.flights is not None and after.flights is None:
            after = _times(before, factor)
        elif after.flights is not None and before.flights is None:
            before = _times(after, factor)
        return Bifurcation(gamma, "period doubling", before, after)
    if known == "fold" and right is not None and right.flights == 1 and right.locked:
        return Bifurcation(gamma, "lock", before, after)
    if known in ("fold", "grazing"):
        return Bifurcation(gamma, known, before, after)
    low = left.high if left is not None and not left.locked else gamma - room
    high = right.low if right is not None and not right.locked else max(gamma, low) + room
    kind = change(ball.itinerary(low, ball.most_flights), ball.itinerary(high, ball.most_flights))
    if ball.bounces:
        return Bifurcation(gamma, kind, before, after)
    if kind == "stick lost" and before.resets == 1:  # a locked cycle begins there, however short its window
        return Bifurcation(gamma, "lock", before, replace(before, resets=0))
    if kind == "stick gained" and after.resets == 1:
        return Bifurcation(gamma, kind, replace(after, resets=0), after)
    return Bifurcation(gamma, kind, before, after)


def _times(side: Side, factor: float) -> Side:
    if side.period is None or side.flights is None:
        return side
    return Side(int(side.period * factor), int(side.flights * factor), side.resets)


def change(below: Itinerary, above: Itinerary) -> str:
    """What happens between two neighbouring gammas, by the first flight whose symbol differs."""
    n = min(below.symbol.size, above.symbol.size)
    differ = np.flatnonzero((below.symbol[:n] != above.symbol[:n]) | (below.rests[:n] != above.rests[:n]))
    if differ.size == 0:
        return "basin"
    k = int(differ[0])
    if below.symbol[k] == above.symbol[k]:  # a chatter that comes to its end, or just does not
        return "stick lost" if below.rests[k] else "stick gained"
    # over neighbouring doubles a landing moves by 1e-5 at most (as a cube root) unless it jumps
    if abs(math.remainder(below.landing[k] - above.landing[k], TWO_PI)) > 1e-3:
        return "grazing"
    if k < min(below.first, above.first):
        return "basin"
    crossed = max(int(below.symbol[k]), int(above.symbol[k]))
    lands_later_above = above.symbol[k] > below.symbol[k]
    if crossed % 2 == 0:  # the edge crossed is a threshold: before it the ball sticks, after it it is thrown
        return "stick lost" if lands_later_above else "stick gained"
    return "flight lost" if lands_later_above else "flight gained"


def _side(window: Window) -> Side:
    return Side(window.period, window.flights, window.resets)


def _side_at(ball: ExactBall, gamma: float, direction: int, windows: list[Window]) -> Side:
    """The cycle just below or above ``gamma``: from the windows, else from the orbit from rest there."""
    # 64 doubles away: nearer, rounding may put a landing on the wrong side of a threshold
    near = gamma + direction * 64 * np.spacing(max(gamma, 1.0))
    for window in windows:
        if window.low <= near <= window.high:
            return _side(window)
    row = ball.itinerary_codes(np.array([near]), ball.most_flights)[0]
    if row[FLIGHTS] == 0:
        return Side(1, 0, 0)
    return Side(int(row[PERIOD]), int(row[FLIGHTS]), int(row[RESETS])) if row[FLIGHTS] > 0 else Side()


def _accumulations(ball: ExactBall, windows: list[Window], cuts: list[float]) -> list[Bifurcation]:
    """Points in the gaps between windows at which a landing of the orbit from rest falls on an unstable cycle."""
    out: list[Bifurcation] = []
    for left, right in pairwise(windows):
        if right.low - left.high < SAME or left.locked or right.locked or _near(left.high, cuts):
            continue
        for n in range(1, 5):  # unstable cycles of up to four flights
            gamma = _falls_on_cycle(ball, left.high, right.low, n)
            if gamma is not None:
                out.append(Bifurcation(gamma, "accumulation", _side(left), _side(right)))
                break
    return out


def _falls_on_cycle(ball: ExactBall, low: float, high: float, n: int) -> float | None:
    """The gamma between two at which the orbits' last common landing falls on an unstable cycle of ``n`` flights."""
    below, above = ball.itinerary(low, ball.most_flights), ball.itinerary(high, ball.most_flights)
    m = min(below.symbol.size, above.symbol.size)
    differ = np.flatnonzero(below.symbol[:m] != above.symbol[:m])
    common = int(differ[0]) if differ.size else m
    # landings farther back hardly depend on gamma, and one on the cycle stays on it: the last six are asked
    for k in range(common - 1, max(common - 7, -1), -1):
        # a landing in a concave branch waits for the threshold: it falls on no cycle
        if below.symbol[k] % 2 == 1:
            return None

        def miss(gamma: float, k: int = k) -> float:
            landing = ball.itinerary(gamma, k + 1).landing[k]
            cycle = ball.close(gamma, State(landing), n)
            if cycle is None or abs(cycle.multiplier) <= 1.0:
                raise _NoCycleError
            off = [math.remainder(landing - p, TWO_PI) for p in cycle.phase]
            return min(off, key=abs)

        try:
            a, b = miss(low), miss(high)
            # the landing must pass the cycle between both gammas, and near to it: a far change of sign is a whole turn
            if a * b < 0.0 and max(abs(a), abs(b)) < 0.1:
                gamma = float(brentq(miss, low, high, xtol=1e-15, rtol=1e-15))
                # rounding, stretched on the way through the flights before, leaves no more than this
                return gamma if abs(miss(gamma)) < 1e-6 else None
        except _NoCycleError:
            continue
    return None


class _NoCycleError(ArithmeticError):
    """There is no unstable cycle where a landing was to fall on one."""
