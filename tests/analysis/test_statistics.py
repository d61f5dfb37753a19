"""Robust spread and nearest-time matching."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.statistics import mad_sigma, median, nearest


def test_the_robust_spread_is_the_standard_deviation_despite_outliers() -> None:
    """Of normal deviations with 5 % gross outliers the spread is that of the normal ones, to a tenth."""
    deviations = 3.0 * np.random.default_rng(1).standard_normal(4000)
    deviations[:200] = 1e6
    assert mad_sigma(deviations) == pytest.approx(3.0, rel=0.1)


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
