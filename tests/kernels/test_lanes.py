"""Numbers in lanes."""

from __future__ import annotations

import numpy as np

from kernels.lanes import WIDTH, count, load
from model.flight.numerics import compiled


@compiled
def _above(numbers, bound):
    return count(load(numbers, 0) > bound)


def test_lanes_that_are_true_are_counted():
    """Of the numbers 0, 1, ... as many exceed any bound as should, none and all among the cases."""
    numbers = np.arange(WIDTH, dtype=np.float64)
    for bound in range(-1, WIDTH):
        assert _above(numbers, float(bound)) == WIDTH - 1 - bound
