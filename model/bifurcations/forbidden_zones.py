"""Forbidden zones: flight times that no flight can have, whatever the phase of its take-off.

Flight time as a function of take-off phase jumps only at a graze; between jumps it is continuous,
so what is reached is a union of intervals, one a piece, and a zone is what lies between them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize_scalar

from kernels.arrays import Floats, Integers
from model.flight import ideal, windows
from model.flight.branches import TWO_PI, branch_of, fold, q_and_slope
from model.flight.numerics import compiled
from model.tones import Forcing

Fly = Callable[[Floats], tuple[Floats, Integers]]

SMALLEST_ZONE = 1e-3  # gaps narrower than this are not shown


@compiled
def _flights_from(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, phases: Floats, tau: Floats, index: Integers
) -> None:
    for k in range(phases.shape[0]):
        phi = fold(phases[k], edge[0])
        a0 = max(gamma * q_and_slope(tones, phi)[0] - 1.0, 0.0)
        tau[k], landing, _, _ = ideal.land(tones, gamma, edge, n_windows, phi, a0, 0.0)
        # equal numbers mean equal branches of the flight: the flight time is continuous between two such phases
        turns = round((phi + tau[k] - landing) / TWO_PI)
        index[k] = 2 * n_windows * turns + branch_of(edge, n_windows, landing)


def forbidden_zones(forcing: Forcing, gamma: float) -> Floats:
    """Gaps between the flight times that occur at ``gamma``: shape (k, 2), ascending; none below take-off.

    Raises `ValueError` if gamma is negative or not finite.
    """
    edge, n_windows = windows.edges(forcing, gamma)
    reached: list[tuple[float, float]] = []
    for window in range(n_windows):
        reached += _pieces(forcing, gamma, edge, n_windows, float(edge[2 * window]), float(edge[2 * window + 1]))
    reached.sort()
    zones = []
    top = 0.0
    for low, high in reached:
        if low - top > SMALLEST_ZONE:
            zones.append((top, low))
        top = max(top, high)
    return np.array(zones).reshape(-1, 2)


def _pieces(
    forcing: Forcing, gamma: float, edge: Floats, n_windows: int, start: float, stop: float
) -> list[tuple[float, float]]:
    """Least and greatest flight time of each continuous piece, over the take-offs in one window."""

    def fly(phases: Floats) -> tuple[Floats, Integers]:
        tau, index = np.empty(phases.size), np.empty(phases.size, dtype=np.int64)
        _flights_from(forcing.tones, gamma, edge, n_windows, np.ascontiguousarray(phases), tau, index)
        return tau, index

    # closer together near the ends, where flights are short and grazes crowd
    phases = start + (stop - start) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 1001)))[:-1]
    tau, index = fly(phases)
    pieces = [[(float(phases[0]), float(tau[0]))]]
    for k in range(1, phases.size):
        if index[k] != index[k - 1]:
            for left, right in _jumps(fly, float(phases[k - 1]), float(phases[k])):
                pieces[-1].append(left)
                pieces.append([right])
        pieces[-1].append((float(phases[k]), float(tau[k])))
    pieces[-1].append((stop, 0.0))  # a take-off at the very end of a window does not leave
    return [_range_of(fly, np.array(piece)) for piece in pieces]


def _jumps(fly: Fly, a: float, b: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """The jumps of the flight time between two take-off phases: ``(phase, flight time)`` on either side of each."""
    found = []
    last = fly(np.array([b]))[1][0]
    while (here := fly(np.array([a]))[1][0]) != last:
        low, high = a, b
        while high - low > 1e-13:
            middle = 0.5 * (low + high)
            if fly(np.array([middle]))[1][0] == here:
                low = middle
            else:
                high = middle
        before, after = (float(t) for t in fly(np.array([low, high]))[0])
        if abs(after - before) > SMALLEST_ZONE:
            found.append(((low, before), (high, after)))
        a = high
    return found


def _range_of(fly: Fly, piece: Floats) -> tuple[float, float]:
    """Least and greatest flight time of a piece (m, 2) of phases and flight times, refined between the samples."""
    phases, tau = piece.T
    ends = []
    for sign in (1.0, -1.0):
        k = int(np.argmin(sign * tau))
        # an extremum between samples is smooth; at an end of the piece the sample itself is the extremum
        best = float(tau[k])
        if 0 < k < tau.size - 1:
            inside = minimize_scalar(
                lambda p, s=sign: s * fly(np.array([p]))[0][0],
                bounds=(phases[k - 1], phases[k + 1]),
                method="bounded",
                options={"xatol": 1e-12},
            )
            best = sign * min(sign * best, float(inside.fun))
        ends.append(best)
    return ends[0], ends[1]
