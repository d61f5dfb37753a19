"""Rows of a table, a row a lane."""

from __future__ import annotations

import numpy as np

from kernels import njit
from kernels.lanes import WIDTH, load, store
from kernels.rows import ROW, gather_rows


@njit()
def _columns(table, places, out):
    columns = gather_rows(table, load(places, 0))
    store(out, 0, columns[0])
    store(out, WIDTH, columns[1])
    store(out, 2 * WIDTH, columns[2])
    store(out, 3 * WIDTH, columns[3])


def test_rows_come_back_as_columns():
    """Each lane gets the four numbers of its own row, in any order and with rows that several lanes share."""
    table = np.arange(40.0 * ROW)
    rows = np.random.default_rng(2).integers(0, 40, WIDTH)
    out = np.empty(ROW * WIDTH)
    _columns(table, rows * float(ROW), out)
    assert np.array_equal(out.reshape(ROW, WIDTH), table.reshape(40, ROW)[rows].T)
