"""Branches of the landing map, and the shares of flight times that follow from it without an orbit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from model.orbits.attractor import AT_REST
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.orbits.landing_map import branch_of, landing_map
from model.tones import Forcing

ONE = Forcing.superposition(1)
PAPER = FrictionBall(ONE, 0.3, 0.3, 0.514)


def test_a_flight_belongs_to_as_many_branches_as_crests_are_over() -> None:
    """A locked flight of k periods is of branch k, from whatever phase; a rebound before the crest of branch 0."""
    phase = np.linspace(0.0, 6.2, 50)
    for k in (1, 2, 3):
        assert np.all(branch_of(phase, 2.0 * math.pi * k) == k)
    assert branch_of(0.1, 0.5) == 0


def test_hardly_a_ball_lands_half_way_down_a_crest() -> None:
    """One landing in a hundred, at most, of the paper's ball at gamma_peak 3.4 is within a tenth of a period of pi."""
    found = landing_map(PAPER, 1.7, np.random.default_rng(0))
    landing = np.mod(found.phase + found.tau, 2.0 * math.pi)
    seen = found.tau > 0.1 * math.pi
    half_way = seen & (np.abs(landing - math.pi) < 0.2 * math.pi)
    assert found.share[half_way].sum() < 0.01 * found.share[seen].sum()


def test_shares_of_the_branches_are_those_of_an_orbit() -> None:
    """Two humps: what the map predicts without an orbit is within 0.04 of what 6000 flights of a noisy orbit show."""
    rng = np.random.default_rng(1)
    found = landing_map(PAPER, 1.7, np.random.default_rng(0))
    assert found.share.sum() == pytest.approx(1.0)
    state, phase, tau = AT_REST, np.empty(6000), np.empty(6000)
    for i, gamma in enumerate(1.7 * (1.0 + 0.005 * rng.standard_normal(6000))):
        one = PAPER.fly(float(gamma), state, 1)
        phase[i], tau[i], state = one.phase[0], one.tau[0], one.last
    seen = tau > 0.1 * math.pi
    share = np.where(found.tau > 0.1 * math.pi, found.share, 0.0)
    for m in range(3):
        flown = np.mean(branch_of(phase, tau)[seen] == m)
        assert share[found.branch == m].sum() / share.sum() == pytest.approx(flown, abs=0.04)


def test_a_ball_that_never_rebounds_has_no_such_map() -> None:
    """The completely inelastic ball below its lock forgets each landing: its map has one state, and is refused."""
    with pytest.raises(ValueError, match="one state"):
        landing_map(IdealBall(ONE), 1.0, np.random.default_rng(0))
