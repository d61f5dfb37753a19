"""Arrays lent without a reference count."""

from __future__ import annotations

import sys

import numpy as np

from kernels import njit
from kernels.borrowed import borrowed


@njit()
def _filled(array):
    lent = borrowed(array)
    row = lent[1]
    row[:] = 2.0
    return lent.sum()


def test_what_is_written_to_a_lent_array_is_in_its_owner():
    """A view of a lent array writes through, and the owner keeps its own count of references."""
    array = np.ones((2, 3))
    count = sys.getrefcount(array)
    assert _filled(array) == 9.0
    assert np.array_equal(array, [[1.0] * 3, [2.0] * 3])
    assert sys.getrefcount(array) == count
