"""Tables of edges in lanes."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from kernels.lanes import WIDTH
from model.flight.branches import fill_edges
from model.flight.lanes.edge_table import FOUND, TABLE, fill_tables
from model.flight.windows import turning_points
from model.tones import Forcing


def _tables(forcing: Forcing, gammas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The tables (gammas, edges, 3) and the numbers of windows."""
    turning = turning_points(forcing)
    size = turning.size + 2
    table, windows = np.zeros(gammas.size * TABLE * size), np.zeros(gammas.size, dtype=np.int64)
    fill_tables(forcing.tones, turning, gammas, table, windows, np.zeros(FOUND * size * WIDTH))
    return table.reshape(gammas.size, size, TABLE), windows


@pytest.mark.parametrize("c", [1, 2, 3, 7])
def test_edges_are_exact_to_rounding(c):
    """Every edge lies within rounding of the root of ``gamma q = 1`` in 40 digits, and none is missing."""
    forcing = Forcing.superposition(c)
    turning = turning_points(forcing)
    gammas = np.linspace(0.1, 8.0, 2 * WIDTH)
    tables, windows = _tables(forcing, gammas)
    tones = [tuple(map(mp.mpf, map(float, tone))) for tone in forcing.tones]
    with mp.workdps(40):
        for gamma, table, n in zip(gammas, tables, windows, strict=True):
            assert n == fill_edges(forcing.tones, turning, gamma, np.zeros(turning.size + 2))
            for x in table[: 2 * n, 0]:
                x = mp.mpf(float(x))
                value = gamma * sum(b * n * n * mp.sin(n * x + p) for n, b, p in tones) - 1
                slope = gamma * sum(b * n**3 * mp.cos(n * x + p) for n, b, p in tones)
                assert abs(value) < 3e-15 * (1 + abs(slope))


def test_a_table_does_not_depend_on_its_neighbours():
    """The same gamma gives the same bits among any others: rows computed in parts or anew are the same."""
    forcing, gammas = Forcing.superposition(3), np.linspace(0.2, 6.0, WIDTH)
    one = _tables(forcing, gammas)[0]
    other = _tables(forcing, np.concatenate([gammas[::-1], gammas]))[0]
    assert np.array_equal(one, other[WIDTH:])
    assert np.array_equal(one, other[:WIDTH][::-1])
