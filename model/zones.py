"""Forbidden zones: flight times that no flight can have, whatever the phase of its take-off.

The rule kept here: flight time as a function of take-off phase jumps only at a graze; between jumps it is continuous, so
what is reached is a union of intervals, one a piece, and a zone is what lies between them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from model import flight, ideal_kernel
from model.branches import branch_of, fold, q_and_slope
from model.compiled import Floats, compiled
from model.tones import Forcing

PHASES = 2000  # take-off phases tried in a window
JUMP = 1e-13  # phase to which a jump is bisected
SMALLEST_ZONE = 1e-3  # gaps narrower than this are not shown


@compiled
def _flights_from(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, phases: Floats, tau: Floats, index: NDArray[np.int64]
) -> None:
    for k in range(phases.shape[0]):
        phi = fold(phases[k], edge[0])
        a0 = max(gamma * q_and_slope(tones, phi)[0] - 1.0, 0.0)
        tau[k], landing, _, _ = ideal_kernel.land(tones, gamma, edge, n_windows, phi, a0, 0.0)
        turns = round((phi + tau[k] - landing) / 6.283185307179586)
        # a landing that passes from one branch into the next is no jump; one that leaves out a whole branch is
        index[k] = 2 * n_windows * turns + branch_of(edge, n_windows, landing)


def forbidden_zones(forcing: Forcing, gamma: float) -> NDArray[np.float64]:
    """Gaps between the flight times that occur at ``gamma``: shape (k, 2), ascending; none below take-off.

    Raises
    ------
    ValueError
        If gamma is negative or not finite.
    """
    edge, n_windows = flight.edges(forcing, gamma)
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

    def fly(phases: Floats) -> tuple[Floats, NDArray[np.int64]]:
        tau, index = np.empty(phases.size), np.empty(phases.size, dtype=np.int64)
        _flights_from(forcing.tones, gamma, edge, n_windows, np.ascontiguousarray(phases), tau, index)
        return tau, index

    # closer together near the ends, where flights are short and grazes crowd
    phases = start + (stop - start) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, PHASES + 1)))[:-1]
    tau, index = fly(phases)
    steep = np.abs(np.diff(tau)) > 20.0 * np.median(np.abs(np.diff(tau))) + 1e-6
    cuts = [0]
    low_high: list[tuple[float, float]] = []
    extra: list[float] = []
    for k in np.flatnonzero((index[1:] != index[:-1]) & steep):
        a, b = float(phases[k]), float(phases[k + 1])
        while b - a > JUMP:
            middle = 0.5 * (a + b)
            if fly(np.array([middle]))[1][0] == index[k]:
                a = middle
            else:
                b = middle
        sides = fly(np.array([a, b]))[0]
        if abs(sides[1] - sides[0]) > SMALLEST_ZONE:
            low_high.append((float(sides[0]), float(sides[1])))
            cuts.append(int(k) + 1)
    cuts.append(phases.size)
    out = []
    for i, (a_index, b_index) in enumerate(zip(cuts, cuts[1:], strict=False)):
        values = list(tau[a_index:b_index])
        extra = ([low_high[i - 1][1]] if i > 0 else []) + ([low_high[i][0]] if i < len(low_high) else [])
        inner = slice(a_index, b_index)
        values += extra + _extremes(lambda p: float(fly(np.array([p]))[0][0]), phases[inner], tau[inner])
        if b_index == phases.size:
            values.append(0.0)  # take-offs at the very end of a window do not leave
        out.append((float(min(values)), float(max(values))))
    return out


def _extremes(tau_at: object, phases: Floats, tau: Floats) -> list[float]:
    """Inner minimum and maximum of a piece, refined from the samples around them."""
    found = []
    for sign in (1.0, -1.0):
        k = int(np.argmin(sign * tau))
        if 0 < k < tau.size - 1:
            best = minimize_scalar(
                lambda p, s=sign: s * tau_at(p), bounds=(phases[k - 1], phases[k + 1]), method="bounded",  # type: ignore[operator]
                options={"xatol": 1e-12},
            )
            found.append(sign * float(best.fun))
    return found
