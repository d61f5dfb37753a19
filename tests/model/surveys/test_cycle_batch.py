"""Cycles of many rows in lanes."""

from __future__ import annotations

import numpy as np
import pytest

from model.flight import windows
from model.orbits.attractor import FEW_FLIGHTS, MAX_FLIGHTS, attractor
from model.orbits.exact_ball import IdealBall
from model.surveys import cycle_batch
from model.tones import Forcing


def _batch(batch, forcing: Forcing, gammas: np.ndarray, laws: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """``outcome`` and ``kept``."""
    outcome, kept = np.empty((gammas.size, cycle_batch.OUTCOME_SIZE), dtype=np.int64), np.empty((gammas.size, 16))
    turning = windows.turning_points(forcing)
    batch(cycle_batch.Points(forcing.tones, turning, gammas, laws, True, outcome, kept), most)
    return outcome, kept


@pytest.mark.parametrize("law", [(0.0, 0.0, 0.0, 0.0), (0.3, 0.3, 0.3, 0.0)])
def test_a_row_does_not_depend_on_its_neighbours(law):
    """Rows beyond a block of tables, in any order, are the same bits as alone."""
    forcing = Forcing.superposition(2)
    batch = cycle_batch.ideal_batch if not any(law) else cycle_batch.friction_batch
    gammas = np.linspace(0.2, 5.0, cycle_batch.BLOCK + 100)
    laws = np.tile(law, (gammas.size, 1))
    outcome, kept = _batch(batch, forcing, gammas, laws, FEW_FLIGHTS)
    backwards, kept_backwards = _batch(batch, forcing, gammas[::-1].copy(), laws, FEW_FLIGHTS)
    np.testing.assert_array_equal(outcome, backwards[::-1])
    np.testing.assert_array_equal(kept, kept_backwards[::-1])
    few = slice(200, 203)
    alone, kept_alone = _batch(batch, forcing, gammas[few].copy(), laws[few], FEW_FLIGHTS)
    np.testing.assert_array_equal(outcome[few], alone)
    np.testing.assert_array_equal(kept[few], kept_alone)


def test_locked_cycles_beside_their_doublings_are_those_of_one_at_a_time():
    """One sine, through the first doubling and beyond: flights and period of every locked cycle agree."""
    forcing = Forcing.superposition(1)
    gammas = np.linspace(1.80, 1.95, 40)
    outcome, _ = _batch(cycle_batch.ideal_batch, forcing, gammas, np.zeros((40, 4)), MAX_FLIGHTS)
    ball, locked = IdealBall(forcing), 0
    for gamma, row in zip(gammas, outcome, strict=True):
        found = attractor(ball, float(gamma))
        if row[cycle_batch.FLIGHTS] != cycle_batch.OPEN:
            assert bool(row[cycle_batch.LOCKED]) == found.locked
            assert (row[cycle_batch.FLIGHTS], row[cycle_batch.PERIOD]) == (found.flights, found.period)
            locked += found.locked
    assert locked > 20
