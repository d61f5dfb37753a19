"""Change points of a noisy sequence's level: penalised least squares, solved exactly.

The partition minimises the squared deviations from each part's mean, in units of their standard deviations, plus a
penalty for each part (optimal partitioning: Jackson et al., IEEE Signal Process. Lett. 12 (2005) 105).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from kernels import njit
from kernels.arrays import Floats


class SegmentCosts:
    """Weighted means of a sequence over any range, and the squared deviations from them, in constant time.

    ``values`` is (n, d), as ``sigma``, the standard deviation of each.
    """

    def __init__(self, values: Floats, sigma: Floats) -> None:
        weight = 1.0 / sigma**2
        origin = np.median(values, axis=0)
        shifted = values - origin
        self._origin = origin
        self._w, self._wy, self._wyy = (
            np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
            for x in (weight, weight * shifted, weight * shifted**2)
        )

    def cuts(self, penalty: float) -> list[int]:
        """Ends of the cheapest partition, the first and the last included; each part costs ``penalty``."""
        n = len(self._w) - 1
        previous = np.zeros(n + 1, np.int64)
        _partition(self._w, self._wy, self._wyy, penalty, previous)
        ends = [n]
        while ends[-1] > 0:
            ends.append(int(previous[ends[-1]]))
        return ends[::-1]

    def mean(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Mean of each column over ``start .. stop``, and its standard error."""
        w = self._w[stop] - self._w[start]
        return self._origin + (self._wy[stop] - self._wy[start]) / w, 1.0 / np.sqrt(w)


def segments(values: Floats, sigma: Floats, same: Floats, penalty: float) -> list[tuple[int, int]]:
    """Parts of constant level as ``(start, stop)``, in order, covering the sequence.

    ``values`` is (n, d), as ``sigma``, the standard deviation of each. A part costs ``penalty``; neighbouring parts
    whose means differ by less than ``same`` (d,) in each column are one.
    """
    costs = SegmentCosts(values, sigma)
    first, *others = pairwise(costs.cuts(penalty))
    parts = [first]
    for start, stop in others:
        before, sigma_before = costs.mean(*parts[-1])
        after, sigma_after = costs.mean(start, stop)
        if np.all(np.abs(after - before) < np.maximum(4.0 * np.hypot(sigma_before, sigma_after), same)):
            parts[-1] = (parts[-1][0], stop)
        else:
            parts.append((start, stop))
    return parts


@njit(error_model="numpy")
def _partition(w, wy, wyy, penalty, previous):  # type: ignore[no-untyped-def]
    """Begin of the last part of the cheapest partition up to each place, from cumulative sums (n + 1, d)."""
    n, d = w.shape[0] - 1, w.shape[1]
    best = np.zeros(n + 1)
    for stop in range(1, n + 1):
        best[stop] = np.inf
        for start in range(max(0, stop - 192), stop):  # longer parts come back together afterwards
            cost = best[start] + penalty
            for k in range(d):
                cost += wyy[stop, k] - wyy[start, k] - (wy[stop, k] - wy[start, k]) ** 2 / (w[stop, k] - w[start, k])
            if cost < best[stop]:
                best[stop], previous[stop] = cost, start
