"""Branches of cycles through every change of stability."""

from __future__ import annotations

import math

import numpy as np
import pytest

from model.bifurcations.continuation import cycle_branches
from model.orbits.attractor import State
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.tones import Forcing

ONE_SINE = Forcing.superposition(1)


def test_the_locked_cycle_lives_on_beyond_its_doubling() -> None:
    """One sine: phase and multiplier are the closed forms to 1e-12 from the lock to gamma_peak 7, stable or not."""
    branch = next(b for b in cycle_branches(IdealBall(ONE_SINE), 1.5, 3.5) if (b.flights, b.periods) == (1, 1))
    peak = 2.0 * branch.gamma
    assert peak[0] == pytest.approx(math.sqrt(math.pi**2 + 1.0), abs=1e-3)
    assert peak[-1] == 7.0
    np.testing.assert_allclose(branch.phase[:, 0], np.arccos(math.pi / peak), rtol=0, atol=1e-12)
    np.testing.assert_allclose(branch.multiplier, 1.0 - np.sqrt(peak**2 - math.pi**2), rtol=0, atol=1e-12)


def test_with_restitution_the_branch_passes_its_doubling() -> None:
    """e = 0.3: from the fold on, through multiplier -1 where the closed form has it."""
    e = 0.3
    lock = math.pi * (1 - e) / (1 + e)
    doubling = math.sqrt(lock**2 + (2 * (1 + e * e) / (1 + e) ** 2) ** 2) / 2
    found = cycle_branches(FrictionBall(ONE_SINE, e0=e), 0.8, 2.0, 1)
    branch = next(b for b in found if b.periods == 1 and b.multiplier.min() < -1.0 < 0.0 < b.multiplier.max())
    assert branch.gamma[0] == pytest.approx(lock / 2, abs=1e-4)
    before, after = np.interp([doubling - 1e-3, doubling + 1e-3], branch.gamma, branch.multiplier)
    assert after < -1.0 < before


def test_a_cycle_of_two_flights_is_found_beside_the_one_it_came_from() -> None:
    """One sine: the locked 2-cycle between its birth at 3.724192 and where it begins to stick, 3.856854."""
    branch = next(b for b in cycle_branches(IdealBall(ONE_SINE), 1.5, 2.5) if b.flights == 2)
    np.testing.assert_allclose(2.0 * branch.gamma[[0, -1]], [3.724192, 3.856854], rtol=0, atol=2e-3)


@pytest.mark.parametrize("ratio", [2, 3])
def test_with_two_tones_and_friction_multipliers_are_the_maps(ratio: int) -> None:
    """Every branch: each multiplier is the derivative of the flown map, by differences; each phase comes back."""
    ball = FrictionBall(Forcing.superposition(ratio), 0.1, 0.1)
    found = [b for b in cycle_branches(ball, 0.7, 2.0) if b.flights == 1]
    assert any(b.periods == 1 and b.multiplier.min() < -4.0 for b in found)
    for branch in found:
        for k in range(1, len(branch.gamma), 40):
            gamma, phase, h = float(branch.gamma[k]), float(branch.phase[k, 0]), 1e-6
            ends = [phase + s * h + ball.fly(gamma, State(phase + s * h), 1).tau[0] for s in (-1.0, 1.0)]
            assert (ends[1] - ends[0]) / (2.0 * h) == pytest.approx(branch.multiplier[k], rel=1e-3, abs=1e-3)
            assert math.remainder(0.5 * sum(ends) - phase, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)
