"""Robust spread and nearest-time matching."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtrc

from analysis.statistics import chance_of_squares, core_sigma, mad_sigma, median, nearest


def test_the_robust_spread_is_the_standard_deviation_despite_outliers() -> None:
    """Of normal deviations with 5 % gross outliers the spread is that of the normal ones, to a tenth."""
    deviations = 3.0 * np.random.default_rng(1).standard_normal(4000)
    deviations[:200] = 1e6
    assert mad_sigma(deviations) == pytest.approx(3.0, rel=0.1)


def test_the_spread_of_the_core_is_the_standard_deviation_whatever_is_beyond_it() -> None:
    """Of normal deviations with 0.2 % gross outliers, to a fiftieth."""
    sizes = np.abs(5.0 * np.random.default_rng(2).standard_normal(40_000))
    sizes[:80] = 1e6
    assert core_sigma(sizes) == pytest.approx(5.0, rel=0.02)


@pytest.mark.parametrize("n", [1, 2, 40])
def test_the_nearest_entry_is_that_of_a_full_search(n: int) -> None:
    """Before the first entry, after the last and between, the index is that of the smallest distance."""
    rng = np.random.default_rng(n)
    values, wanted = np.sort(rng.random(n)), rng.uniform(-0.5, 1.5, 200)
    np.testing.assert_array_equal(nearest(values, wanted), np.abs(values[:, None] - wanted).argmin(axis=0))


def test_the_median_of_a_short_array_is_that_of_numpy_to_the_last_bit() -> None:
    """Odd and even lengths, a single value, infinities; not a number where one is none."""
    rng = np.random.default_rng(5)
    for values in (*(rng.normal(size=n) for n in range(1, 30)), np.array([1.0, np.inf]), np.array([2.0, np.nan])):
        np.testing.assert_array_equal(median(values), np.median(values))


@pytest.mark.parametrize("n", [1, 5, 300])
def test_the_chance_of_squares_is_never_stated_too_small(n: int) -> None:
    """Of equal variances the bound lies above chi-square's tail, by a few tens of times down to 1e-12."""
    for sigmas in (0.5, 2.0, 4.0, 6.0):
        total = n + sigmas * np.sqrt(2.0 * n)
        exact, bound = chdtrc(n, total), chance_of_squares(9.0 * total, np.full(n, 9.0))
        assert exact <= bound <= 50.0 * exact
    unequal = np.array([4.0] + [0.01] * 50)
    drawn = (np.random.default_rng(1).standard_normal((20_000, 51)) ** 2 @ unequal > 16.0).mean()
    assert drawn <= chance_of_squares(16.0, unequal) <= 10.0 * drawn
