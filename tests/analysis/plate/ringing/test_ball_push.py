"""What the ball does to the plate, from the plate's acceleration and the times of its flights."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.plate.ringing.ball_push import ball_push, filled_after_impacts
from kernels.arrays import Floats

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


def test_blocks_that_an_impact_hides_are_bridged() -> None:
    """A line joins the known ones."""
    known = np.ones(10, dtype=np.bool_)
    known[4:7] = False
    filled = filled_after_impacts(np.where(known, np.arange(10.0), 99.0), known)
    np.testing.assert_allclose(filled, np.arange(10.0))


def marched(least_mps2: float, friction: float, late_s: float) -> tuple[Floats, Floats, Floats]:
    """Plate in blocks as a late accelerometer shows it, flights (n, 2), impact speeds (n,) of a ball that stays.

    The plate moves as a sine of 20 Hz, of a size that grows from ``least_mps2`` by 2 m/s^2 a second.
    """
    dt, w = 1e-5, 2.0 * np.pi * 20.0
    height, speed, flying, flights, hits = 0.0, 0.0, False, list[float](), list[float]()
    for k in range(300_000):
        free = -G + (least_mps2 + 2e-5 * k) * np.sin(w * k * dt)
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
    then_s = (np.arange(6000) + 0.5) * BLOCK_S - late_s
    shown = -(least_mps2 + 2e-5 / dt * then_s) * np.sin(w * then_s)
    return shown, np.array(flights[: len(hits) * 2]).reshape(-1, 2), np.array(hits)


@pytest.mark.parametrize(("friction", "late_s"), [(0.06 * G, 0.0), (0.0, 1e-4)])
def test_a_friction_or_a_late_accelerometer_is_found_from_flights_that_begin_at_rest(
    friction: float, late_s: float
) -> None:
    """Impact speeds of a ball that is marched over a sinusoidal plate come out to a thousandth."""
    shown, edges_s, hits = marched(18.0, friction, late_s)
    impacts = ball_push(shown, BLOCK_S, edges_s[:, 0], edges_s[:, 1], G).impacts_mps2
    assert len(hits) > 30
    assert np.sum(impacts) * BLOCK_S == pytest.approx(-np.sum(hits), rel=0.001)


def test_a_ball_that_does_not_bounce_gives_its_own_speed_wherever_it_leaves_next() -> None:
    """Where it leaves as it lands, and where it lay for a moment: contacts stay closed for 0.2 ms."""
    shown, edges_s, hits = marched(29.0, 0.03 * G, 0.0)
    takeoff_s = np.maximum(edges_s[:, 0], np.append(0.0, edges_s[:-1, 1] + 2e-4))
    brief_s = np.append(edges_s[1:, 0] - edges_s[:-1, 1], np.inf)
    push = ball_push(shown, BLOCK_S, takeoff_s, edges_s[:, 1], G)
    push = ball_push(shown, BLOCK_S, takeoff_s, edges_s[:, 1], G, before=push)
    assert push.stays
    assert np.sum(brief_s < 1e-4) > 10
    assert np.sum((brief_s > 1e-4) & (brief_s < 1e-3)) > 10
    np.testing.assert_allclose(push.impulse_mps, -hits, atol=8e-4)
