"""Change points of a level: the partition that costs least, and no more parts than can be told apart."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np

from daq.steps.tone_tracking import SegmentCosts, segments

PENALTY = 6.0


def test_the_partition_is_the_cheapest_of_all() -> None:
    """On short sequences of two columns with unequal weights no other partition costs less."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        values = np.repeat(rng.normal(0, 3, (3, 2)), (3, 4, 2), axis=0) + rng.normal(0, 1, (9, 2))
        sigma = rng.uniform(0.5, 2.0, (9, 2))

        def cost(a: int, b: int, x: np.ndarray = values, s: np.ndarray = sigma) -> float:
            w = s[a:b] ** -2
            mean = (w * x[a:b]).sum(axis=0) / w.sum(axis=0)
            return float((w * (x[a:b] - mean) ** 2).sum()) + PENALTY

        every = [(0, *inner, 9) for k in range(9) for inner in combinations(range(1, 9), k)]
        cheapest = min(every, key=lambda cuts: sum(cost(a, b) for a, b in pairwise(cuts)))
        assert tuple(SegmentCosts(values, sigma).cuts(PENALTY)) == cheapest


def test_a_level_longer_than_the_search_is_one_part() -> None:
    """A thousand values of one level, then another, are two parts, though the search takes 192 values at most."""
    rng = np.random.default_rng(6)
    values = np.concatenate([np.zeros(1000), np.ones(300)])[:, None] + rng.normal(0, 0.1, (1300, 1))
    assert segments(values, np.full((1300, 1), 0.1), np.array([0.01]), 30.0) == [(0, 1000), (1000, 1300)]
