"""The windows of gamma in which the orbit from rest ends in one and the same cycle, to the last digit of their edges.

A window is defined by whole numbers (`ExactBall.itinerary_codes`), so an edge is bisected to neighbouring
doubles with no tolerance; the stretch between two windows is searched again, ever finer, until it is narrower than the
narrowest window asked for.

Without restitution every locked cycle begins at the edge at which a landing meets a threshold, where its multiplier is
0: the orbit that just does not stick any more is all but on it. With restitution there is no such place: locked cycles
are met by running orbits. Either is followed from there (`model.bifurcations.continuation`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kernels.arrays import Floats, Integers
from model.bifurcations.continuation import follow
from model.orbits.attractor import LockedCycle, State, attractor
from model.orbits.cycles import CODE, FLIGHTS, PERIOD, RESETS
from model.orbits.exact_ball import ExactBall

BEYOND = 1e-9  # an edge, where the locked cycle that begins there is looked for
DIGITS = 11  # of gamma, to which the same edge found twice is the same


@dataclass(frozen=True)
class Window:
    """A stretch ``[low, high]`` of gamma with one cycle: its flights, resets and length in forcing periods."""

    low: float
    high: float
    flights: int
    resets: int
    period: int
    code: int
    locked: bool = False
    how: tuple[str, str] = ("", "")
    """Events at its lower and upper end, where known from the locked family; empty where not."""

    @property
    def width(self) -> float:
        """In gamma."""
        return self.high - self.low


def find_windows(ball: ExactBall, low: float, high: float, narrowest: float, longest: int) -> list[Window]:
    """Every window wider than ``narrowest`` of a cycle of at most ``longest`` flights, in order.

    No take-off window may be born or merge between ``low`` and ``high``. The search that goes everywhere has the
    spacing ``ball.coarse``: a window between two of its gammas, with the same cycle on both sides, is missed.
    """
    room = 4 * np.spacing(max(high, 1.0))  # at a take-off level itself rounding decides the number of windows
    first, last = low + room, high - room
    pieces: list[Window] = []
    asked: set[tuple[float, float]] = set()
    locked: list[Window] = []
    found: list[Window] = []
    stretches = [(first, last)] if first < last else []
    # coarse first: what a wide window covers is not searched again; in the end no gap can hold a window
    spacings = [s for s in (100.0 * ball.coarse, ball.coarse, ball.coarse / 10.0) if s > narrowest]
    for spacing in [*spacings, 0.9 * narrowest]:
        grids = [np.linspace(a, b, max(int(np.ceil((b - a) / spacing)), 2) + 1) for a, b in stretches]
        pieces = _joined(pieces + _windows_of(ball, grids, narrowest, longest))
        closed = [w for w in pieces if w.width > narrowest]
        for window in closed:
            # an edge found again on a finer grid differs in its last digits
            edges = round(window.low, DIGITS), round(window.high, DIGITS)
            if edges not in asked:
                asked.add(edges)
                locked += [w for w in _locked_from(ball, window, low, high) if w.width > narrowest]
        open_ = _between(_reached(locked, closed, first, last), first, last, narrowest)
        locked += [w for w in _locked_within(ball, open_, spacing) if w.width > narrowest]
        found = _reached(locked, closed, first, last)
        stretches = _between(found, first, last, narrowest)
    return found


def _joined(found: list[Window]) -> list[Window]:
    """In order, pieces of one window joined: a search cut it where it began, or only the way into the cycle changed."""
    out: list[Window] = []
    for window in sorted(found, key=lambda w: w.low):
        if out and out[-1].code == window.code and window.low <= out[-1].high + 8 * np.spacing(max(window.low, 1.0)):
            out[-1] = replace(out[-1], high=max(out[-1].high, window.high))
        else:
            out.append(window)
    return out


def _reached(locked: list[Window], sticking: list[Window], lowest: float, highest: float) -> list[Window]:
    """All in order; of a locked cycle only where no orbit from rest goes to a cycle with a reset instead."""
    out = list(sticking)
    ends = np.array([w.high for w in sticking])
    seen: set[float] = set()
    for window in (w for w in locked if lowest < w.high and w.low < highest):
        first = int(np.searchsorted(ends, window.low, side="right"))
        low, top = max(window.low, lowest), min(window.high, highest)
        while low < top:
            other = sticking[first] if first < len(sticking) else None
            high = top if other is None else min(top, other.low)
            if high - low > 8 * np.spacing(high) and round(low, DIGITS) not in seen:
                seen.add(round(low, DIGITS))
                how = (window.how[0] if low == window.low else "", window.how[1] if high == window.high else "")
                out.append(replace(window, low=low, high=high, how=how))
            low = top if other is None else max(low, other.high)
            first += 1
    return sorted(out, key=lambda w: w.low)


def _between(found: list[Window], low: float, high: float, narrowest: float) -> list[tuple[float, float]]:
    """Stretches covered by no window and wide enough to hold one."""
    ends = [low, *(w.high for w in found)]
    starts = [*(w.low for w in found), high]
    return [(a, b) for a, b in zip(ends, starts, strict=True) if b - a > narrowest]


def _windows_of(ball: ExactBall, grids: list[Floats], narrowest: float, longest: int) -> list[Window]:
    """Windows met by the samples of each grid, their edges bisected between neighbouring samples that differ."""
    left: list[float] = []
    right: list[float] = []
    ends: list[tuple[float, Integers, float, float, bool]] = []
    for grid in grids:
        rows = ball.itinerary_codes(grid, ball.most_flights)
        change = np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1))
        first = np.concatenate([[0], change + 1])
        last = np.concatenate([change, [grid.size - 1]])
        for i, j in zip(first, last, strict=True):
            if 1 <= rows[i, FLIGHTS] <= longest:
                before, after = max(i - 1, 0), min(j + 1, grid.size - 1)
                # next to the same cycle, entered otherwise, even a narrow piece belongs to a window that may be wide
                kin_near = any(k != m and rows[k, CODE] == rows[m, CODE] for k, m in ((before, i), (after, j)))
                ends.append((grid[i], rows[i], grid[before], grid[after], kin_near))
                left.append(grid[i])
                right.append(grid[j])
    if not ends:
        return []
    rows = np.array([e[1] for e in ends])
    low, below = np.array(left), np.array([e[2] for e in ends])
    high, above = np.array(right), np.array([e[3] for e in ends])
    kin = np.array([e[4] for e in ends])
    # roughly first, so that only what is wide enough is bisected to the last digit
    for tolerance in (0.02 * narrowest, 0.0):
        low, below = _bisect(ball, low, below, rows, tolerance)
        high, above = _bisect(ball, high, above, rows, tolerance)
        wide = (high - low > 0.9 * narrowest) | kin
        kin = kin[wide]
        rows, low, below, high, above = rows[wide], low[wide], below[wide], high[wide], above[wide]
    return [
        Window(float(a), float(b), int(r[FLIGHTS]), int(r[RESETS]), int(r[PERIOD]), int(r[CODE]))
        for a, b, r in zip(low, high, rows, strict=True)
    ]


def _bisect(
    ball: ExactBall, inside: Floats, outside: Floats, rows: Integers, tolerance: float
) -> tuple[Floats, Floats]:
    """Brackets narrowed to ``tolerance`` (0: neighbouring doubles): where the codes ``rows`` still hold, and not.

    Where ``outside`` has the code too (the search ended there) both are ``outside``.
    """
    inside, outside = inside.copy(), outside.copy()
    if inside.size == 0:
        return inside, outside
    # the search ended within the window: there is no edge on this side
    known = np.all(ball.itinerary_codes(outside, ball.most_flights) == rows, axis=1)
    inside[known] = outside[known]
    while True:
        # an edge is known when its bracket is two units in the last place wide
        smallest = 2 * np.spacing(np.maximum(np.abs(inside), 1.0))
        open_ = np.abs(outside - inside) > np.maximum(smallest, tolerance)
        if not open_.any():
            return inside, outside
        middle = 0.5 * (inside[open_] + outside[open_])
        same = np.all(ball.itinerary_codes(middle, ball.most_flights) == rows[open_], axis=1)
        inside[open_] = np.where(same, middle, inside[open_])
        outside[open_] = np.where(same, outside[open_], middle)


def _locked_from(ball: ExactBall, window: Window, low: float, high: float) -> list[Window]:
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


def _locked_within(ball: ExactBall, stretches: list[tuple[float, float]], spacing: float) -> list[Window]:
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
