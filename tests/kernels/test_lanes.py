"""Numbers in lanes."""

from __future__ import annotations

import numpy as np

from kernels import njit
from kernels.lanes import ROW, WIDTH, count, gather_rows, load, select, store


@njit()
def _columns(table, places, out):
    columns = gather_rows(table, load(places, 0))
    store(out, 0, columns[0])
    store(out, WIDTH, columns[1])
    store(out, 2 * WIDTH, columns[2])
    store(out, 3 * WIDTH, columns[3])


@njit()
def _smaller(a, b, out):
    x, y = load(a, 0), load(b, 0)
    pair = select(x < y, (x, 1.0), (y, 2.0))
    store(out, 0, pair[0])
    store(out, WIDTH, pair[1])
    return select(a[0] < b[0], (a[0], 1), (b[0], 2))


@njit()
def _above(numbers, bound):
    return count(load(numbers, 0) > bound)


def test_lanes_that_are_true_are_counted():
    """Of the numbers 0, 1, ... as many exceed any bound as should, none and all among the cases."""
    numbers = np.arange(WIDTH, dtype=np.float64)
    for bound in range(-1, WIDTH):
        assert _above(numbers, float(bound)) == WIDTH - 1 - bound


def test_rows_come_back_as_columns():
    """Each lane gets the four numbers of its own row, in any order and with rows that several lanes share."""
    table = np.arange(40.0 * ROW)
    rows = np.random.default_rng(2).integers(0, 40, WIDTH)
    out = np.empty(ROW * WIDTH)
    _columns(table, rows * float(ROW), out)
    assert np.array_equal(out.reshape(ROW, WIDTH), table.reshape(40, ROW)[rows].T)


def test_tuples_are_selected_item_by_item():
    """Each lane gets all items of the tuple that its mask names, numbers among them; one number gets a whole tuple."""
    a, b = np.random.default_rng(3).uniform(0.0, 1.0, (2, WIDTH))
    out = np.empty(2 * WIDTH)
    assert _smaller(a, b, out) == ((a[0], 1.0) if a[0] < b[0] else (b[0], 2.0))
    np.testing.assert_array_equal(out[:WIDTH], np.minimum(a, b))
    np.testing.assert_array_equal(out[WIDTH:], np.where(a < b, 1.0, 2.0))
