"""Edge jitter from the repetition of the motion: scatter of the contact circuit beyond the edges' own uncertainty.

No model of the ball is used. In a step where the motion repeats after a few periods, corresponding edges of successive
cycles form a sequence. Its slow change (an amplitude modulation) and its spectral lines (hum) do not count as jitter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.statistics import nearest

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_CYCLE = 6  # longest cycle of the motion looked for, in periods
MATCH_S = 5e-4  # largest difference between an edge and that of the next cycle
MIN_MATCHED = 0.8  # part of the edges that must have a partner a cycle later
N_COEFFICIENTS = 4  # coefficients of the polynomial that a sequence of edges may follow
MIN_FREEDOM = 3  # degrees of freedom needed in a step
MIN_EDGES = 6  # edges needed that have a next cycle
MIN_STEPS = 3


def excess_of_steps(
    time_s: Array,
    sigma_s: Array,
    step: Ints,
    seen: NDArray[np.bool_],
    period_s: Array,
    lines_radps: Sequence[Array] = (),
) -> Array:
    """Excess variance of edges from cycle to cycle, in each step that repeats.

    Parameters
    ----------
    time_s, sigma_s, step
        Edges in order, their uncertainty and their step, arrays (n,).
    seen
        Edges used, (n,).
    period_s
        Period of the forcing in each step, (m,).
    lines_radps
        Angular frequencies of each step's lines that are no multiple of the forcing.

    Returns
    -------
    array, shape (k,)
        Square seconds, for each of the k steps that repeat; below zero where edges scatter by less than is stated.
    """
    excess = []
    for i, period in enumerate(period_s):
        own = np.flatnonzero(seen & (step == i))
        squares, freedom = 0.0, 0
        for sequence, off in _sequences(time_s[own], float(period)):
            left, free = _scatter(sequence, off, lines_radps[i] if len(lines_radps) else np.zeros(0))
            squares, freedom = squares + left, freedom + free
        if freedom >= MIN_FREEDOM:
            middle = (1.0 - 2.0 / (9.0 * freedom)) ** 3  # median over mean of chi square (Wilson-Hilferty)
            excess.append(squares / freedom / middle - float(np.median(sigma_s[own])) ** 2)
    return np.array(excess, dtype=np.float64)


def raised(sigma_s: Array, excess_s2: Array) -> Array:
    """Uncertainties (n,) raised by the median excess variance; as they are where fewer than `MIN_STEPS` steps tell."""
    if len(excess_s2) < MIN_STEPS:
        return sigma_s
    return np.asarray(np.sqrt(sigma_s**2 + max(float(np.median(excess_s2)), 0.0)))


def raised_together(sigmas_s: Sequence[Array], excesses_s2: Sequence[Array]) -> list[Array]:
    """Uncertainties of several recordings of one rig, each `raised` by its own steps that repeat.

    Where these are fewer than `MIN_STEPS`, as in a short block, the circuit is the same, and those of all recordings
    tell. The uncertainties are those without excess there, and already raised elsewhere.
    """
    every = np.concatenate(list(excesses_s2))
    return [raised(s, every) if len(own) < MIN_STEPS else s for s, own in zip(sigmas_s, excesses_s2, strict=True)]


def _scatter(time_s: Array, off_s: Array, lines_radps: Array) -> tuple[float, int]:
    """Sum of squares about a polynomial of `N_COEFFICIENTS` and the lines, and its degrees of freedom."""
    slow = np.polynomial.chebyshev.chebvander(np.linspace(-1.0, 1.0, len(off_s)), N_COEFFICIENTS - 1)
    regular = time_s - off_s - time_s[0]  # a line at jittered times would fit the jitter itself
    lines = np.exp(1j * np.outer(regular, lines_radps))
    shapes = np.hstack([slow, lines.real, lines.imag])
    if len(off_s) <= shapes.shape[1]:
        return 0.0, 0
    left = off_s - shapes @ np.linalg.lstsq(shapes, off_s, rcond=None)[0]
    return float(left @ left), len(off_s) - shapes.shape[1]


def _sequences(time_s: Array, period_s: float) -> list[tuple[Array, Array]]:
    """Sequences of corresponding edges a cycle apart, for the shortest cycle after which most edges repeat."""
    for cycle in range(1, MAX_CYCLE + 1):
        later = time_s + cycle * period_s
        inside = later < time_s[-1] + MATCH_S if len(time_s) else np.zeros(0, dtype=bool)
        if inside.sum() < MIN_EDGES:
            break
        partner = nearest(time_s, later)
        matched = inside & (np.abs(time_s[partner] - later) < MATCH_S)
        if matched.sum() >= MIN_MATCHED * inside.sum():
            return _chained(time_s, partner, matched, cycle * period_s)
    return []


def _chained(time_s: Array, partner: Ints, matched: NDArray[np.bool_], cycle_s: float) -> list[tuple[Array, Array]]:
    """Each sequence from its first edge on: times, and times less whole cycles."""
    out = []
    for first in np.setdiff1d(np.flatnonzero(matched), partner[matched]):
        chain = [int(first)]
        while matched[chain[-1]]:
            chain.append(int(partner[chain[-1]]))
        own = time_s[chain]
        out.append((own, own - own[0] - cycle_s * np.arange(len(chain))))
    return out
