"""What the ball does to the plate, from the plate's acceleration and the times of its flights."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.plate.ball_push import ball_push, filled_after_impacts

G, BLOCK_S = 9.80665, 5e-4


def test_the_mean_push_is_the_balls_weight() -> None:
    """Weight, inertia and impacts together hold the ball up, whatever it does, over a plate that goes nowhere."""
    w = 2.0 * np.pi * 20.0
    time_s = (np.arange(4000) + 0.5) * BLOCK_S
    takeoff_s = np.linspace(0.05, 1.9, 38)
    landing_s = takeoff_s + 0.03
    push, _ = ball_push(-15.0 * np.sin(w * time_s), BLOCK_S, takeoff_s, landing_s, G)
    assert np.mean(push) == pytest.approx(-G, abs=1e-6)


def test_an_impact_after_a_rest_has_the_speed_that_the_flight_gained() -> None:
    """Over a plate at rest that is gravity times the flight's length."""
    _, impulses = ball_push(np.zeros(1000), BLOCK_S, np.array([0.1]), np.array([0.15]), G)
    assert impulses == pytest.approx(G * 0.05)


def test_rebounds_give_back_what_the_flights_gained() -> None:
    """A ball that leaves as it lands starts with half a flight's gravity, so each impulse equals a flight's."""
    edges_s = np.linspace(0.1, 0.3, 6)
    push, _ = ball_push(np.zeros(1000), BLOCK_S, edges_s[:-1], edges_s[1:], G)
    at = int(edges_s[2] / BLOCK_S)
    assert np.sum(push[at - 5 : at + 5]) * BLOCK_S == pytest.approx(-G * 0.04, rel=1e-6)


def test_blocks_that_an_impact_hides_are_bridged() -> None:
    """A line joins the known ones."""
    known = np.ones(10, dtype=np.bool_)
    known[4:7] = False
    filled = filled_after_impacts(np.where(known, np.arange(10.0), 99.0), known)
    np.testing.assert_allclose(filled, np.arange(10.0))
