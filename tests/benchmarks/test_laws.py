"""What the regressions of other people are given, and what is carried to another forcing."""

from __future__ import annotations

import numpy as np

from benchmarks.analysis.law_peers import needed


def test_the_value_that_a_flight_needs_is_where_its_residual_is_zero() -> None:
    """Of two such values the one nearest to none; between grid points on the line; unknown where there is none."""
    grid = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    table = np.column_stack([grid - 0.25, (grid - 0.5) * (grid + 1.5), grid**2 + 1.0])
    found = needed(table, grid)
    np.testing.assert_allclose(found[:2], [0.25, 0.375], atol=1e-12)
    assert np.isnan(found[2])
