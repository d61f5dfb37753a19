"""How well edges repeat: what the circuit adds to the uncertainty that its samples show.

The rule kept here: no model is asked. In a step where the motion repeats after a few periods, every edge has its like
in the cycles after; what changes slowly along such a row, as with a plate that swells, or follows a line of the plate
that is no multiple of the forcing, as hum does, is no jitter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LONGEST_CYCLE = 6  # periods after which the motion is looked for again
FARTHEST_S = 5e-4  # at which an edge a cycle later is still its like
LIKE = 0.8  # part of the edges that must have their like
SLOW = 4  # coefficients of the polynomial that a row of edges may follow
LEAST_FREEDOM = 3  # degrees of freedom that tell something of a step
LEAST_AGAIN = 6  # edges that have their like
LEAST_STEPS = 3


def with_jitter(
    time_s: Array,
    sigma_s: Array,
    step: Ints,
    seen: NDArray[np.bool_],
    period_s: Array,
    lines_radps: Sequence[Array] = (),
) -> Array:
    """Uncertainty of edges, raised by what they scatter beyond it from cycle to cycle.

    Parameters
    ----------
    time_s, sigma_s, step
        Edges in order, their uncertainty and their step, arrays (n,).
    seen
        Edges that are looked at, (n,).
    period_s
        Of the forcing in each step, (m,).
    lines_radps
        Angular frequencies of each step's lines that are no multiple of the forcing.

    Returns
    -------
    array, shape (n,)
        ``sigma_s`` itself where fewer than `LEAST_STEPS` steps repeat.
    """
    excess = []
    for i, period in enumerate(period_s):
        own = np.flatnonzero(seen & (step == i))
        squares, freedom = 0.0, 0
        for row, off in _rows(time_s[own], float(period)):
            left, free = _scatter(row, off, lines_radps[i] if len(lines_radps) else np.zeros(0))
            squares, freedom = squares + left, freedom + free
        if freedom >= LEAST_FREEDOM:
            middle = (1.0 - 2.0 / (9.0 * freedom)) ** 3  # of chi square: the median of steps stands for their mean
            excess.append(squares / freedom / middle - float(np.median(sigma_s[own])) ** 2)
    if len(excess) < LEAST_STEPS:
        return sigma_s
    return np.asarray(np.sqrt(sigma_s**2 + max(float(np.median(excess)), 0.0)))


def _scatter(time_s: Array, off_s: Array, lines_radps: Array) -> tuple[float, int]:
    """Sum of squares about a polynomial of `SLOW` coefficients and the lines, and the degrees of freedom in it."""
    slow = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, len(off_s)), SLOW - 1)
    regular = time_s - off_s - time_s[0]  # a line taken at jittered times would hold the jitter, and explain it
    turned = np.exp(1j * np.outer(regular, lines_radps))
    shapes = np.hstack([slow, turned.real, turned.imag])
    if len(off_s) <= shapes.shape[1]:
        return 0.0, 0
    left = off_s - shapes @ np.linalg.lstsq(shapes, off_s, rcond=None)[0]
    return float(left @ left), len(off_s) - shapes.shape[1]


def _rows(time_s: Array, period_s: float) -> list[tuple[Array, Array]]:
    """Rows of edges that are each other's like, a cycle apart, for the shortest cycle after which most come again."""
    for cycle in range(1, LONGEST_CYCLE + 1):
        later = time_s + cycle * period_s
        inside = later < time_s[-1] + FARTHEST_S if len(time_s) else np.zeros(0, dtype=bool)
        if inside.sum() < LEAST_AGAIN:
            break
        after = np.clip(np.searchsorted(time_s, later), 1, len(time_s) - 1)
        like = np.where(later - time_s[after - 1] < time_s[after] - later, after - 1, after)
        known = inside & (np.abs(time_s[like] - later) < FARTHEST_S)
        if known.sum() >= LIKE * inside.sum():
            return _chained(time_s, like, known, cycle * period_s)
    return []


def _chained(time_s: Array, like: Ints, known: NDArray[np.bool_], apart_s: float) -> list[tuple[Array, Array]]:
    """Each row from its first edge on, as measured and with whole cycles taken off."""
    out = []
    for first in np.setdiff1d(np.flatnonzero(known), like[known]):
        chain = [int(first)]
        while known[chain[-1]]:
            chain.append(int(like[chain[-1]]))
        row = time_s[chain]
        out.append((row, row - row[0] - apart_s * np.arange(len(chain))))
    return out
