"""What the ball does to the plate, from the plate's acceleration and the times of its flights."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.plate.ringing.ball_push import ball_push, filled_after_impacts

G, BLOCK_S = 9.80665, 5e-4


def test_the_mean_push_is_the_balls_weight() -> None:
    """Weight, inertia and impacts together hold the ball up, whatever it does, over a plate that goes nowhere."""
    w = 2.0 * np.pi * 20.0
    time_s = (np.arange(4000) + 0.5) * BLOCK_S
    edges_s = np.linspace(0.05, 1.9, 38)
    push = ball_push(-15.0 * np.sin(w * time_s), BLOCK_S, edges_s[:-1], edges_s[1:], G)
    assert np.mean(push.contact_mps2 + push.impacts_mps2) == pytest.approx(-G, abs=1e-6)


def test_an_impact_after_a_rest_has_the_speed_that_the_flight_gained() -> None:
    """Over a plate at rest that is gravity times the flight's length."""
    impulses = ball_push(np.zeros(1000), BLOCK_S, np.array([0.1]), np.array([0.15]), G).impacts_mps2
    assert np.sum(impulses) * BLOCK_S == pytest.approx(-G * 0.05)


def test_rebounds_give_back_what_the_flights_gained() -> None:
    """A ball that leaves as it lands starts with half a flight's gravity, so each impulse equals a flight's."""
    edges_s = np.linspace(0.1, 0.3, 6)
    impulses = ball_push(np.zeros(1000), BLOCK_S, edges_s[:-1], edges_s[1:], G).impacts_mps2
    at = int(edges_s[2] / BLOCK_S)
    assert np.sum(impulses[at - 5 : at + 5]) * BLOCK_S == pytest.approx(-G * 0.04, rel=1e-6)


def test_what_a_ball_gives_by_leaving_at_once_is_told_from_what_its_impact_gives() -> None:
    """After four flights that follow one another the ball stays, and flies once more from there."""
    edges_s = np.linspace(0.1, 0.3, 5)
    takeoff_s, landing_s = np.append(edges_s[:-1], 0.4), np.append(edges_s[1:], 0.45)
    push = ball_push(np.zeros(1000), BLOCK_S, takeoff_s, landing_s, G)
    wanted = [-0.025 * G, -0.025 * G, -0.025 * G, 0.0, 0.0]
    np.testing.assert_allclose(push.left_at_mps(landing_s), wanted, rtol=1e-6, atol=1e-12)


def test_blocks_that_an_impact_hides_are_bridged() -> None:
    """A line joins the known ones."""
    known = np.ones(10, dtype=np.bool_)
    known[4:7] = False
    filled = filled_after_impacts(np.where(known, np.arange(10.0), 99.0), known)
    np.testing.assert_allclose(filled, np.arange(10.0))


@pytest.mark.parametrize(("friction", "late_s"), [(0.06 * G, 0.0), (0.0, 1e-4)])
def test_a_friction_or_a_late_accelerometer_is_found_from_flights_that_begin_at_rest(
    friction: float, late_s: float
) -> None:
    """Impact speeds of a ball that is marched over a sinusoidal plate come out to a thousandth."""
    dt, w = 1e-5, 2.0 * np.pi * 20.0
    height, speed, flying, flights, hits = 0.0, 0.0, False, list[float](), list[float]()
    for k in range(300_000):
        free = -G + (18.0 + 2e-5 * k) * np.sin(w * k * dt)
        if not flying and free > friction:
            flying, speed = True, 0.0
            flights.append(k * dt)
        if flying:
            speed += (free - np.copysign(friction, speed)) * dt
            height += speed * dt
            if height < 0.0:
                hits.append(-speed)
                flights.append(k * dt)
                height, flying = 0.0, False
    edges_s = np.array(flights[: len(hits) * 2]).reshape(-1, 2)
    then_s = (np.arange(6000) + 0.5) * BLOCK_S - late_s
    shown = -(18.0 + 2e-5 / dt * then_s) * np.sin(w * then_s)
    impacts = ball_push(shown, BLOCK_S, edges_s[:, 0], edges_s[:, 1], G).impacts_mps2
    assert len(hits) > 30
    assert np.sum(impacts) * BLOCK_S == pytest.approx(-sum(hits), rel=0.001)
