"""The lag of what was heard behind what was played."""

from __future__ import annotations

import numpy as np
import pytest

from daq.clocks.loss_search import sliding_products


@pytest.mark.parametrize(("m", "n"), [(40, 7), (64, 64), (129, 1), (1000, 333)])
def test_sliding_products_are_those_of_numpy(m: int, n: int) -> None:
    """By Fourier transforms as by sums, whatever the lengths; nothing wraps around."""
    rng = np.random.default_rng([m, n])
    window, piece = rng.standard_normal(m), rng.standard_normal(n)
    np.testing.assert_allclose(sliding_products(window, piece), np.correlate(window, piece, "valid"), atol=1e-11)
