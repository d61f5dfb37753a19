"""Means over blocks of samples."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.signals import block_means


@pytest.mark.parametrize("width", [1, 2, 3, 4, 5, 7, 8, 20, 33, 100])
@pytest.mark.parametrize("skip", [0, 1, 6])
def test_block_means_are_means_of_successive_samples(width: int, skip: int) -> None:
    """For any width and any samples left out before, and a remainder is left out; none where there are too few."""
    x = np.random.default_rng(1).normal(1.0, 1.0, 1013).astype(np.float32)
    blocks = (x.size - skip) // width
    wanted = x[skip : skip + blocks * width].reshape(blocks, width).mean(axis=1, dtype=np.float64)
    np.testing.assert_allclose(block_means(x, width, skip), wanted, atol=1e-6)
    assert block_means(x[: width - 1], width, skip).size == 0
