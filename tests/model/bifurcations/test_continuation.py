"""A bifurcation followed in a second parameter, and a cycle followed to its ends."""

from __future__ import annotations

import math

import numpy as np
import pytest

from model.bifurcations.continuation import follow
from model.orbits.attractor import LockedCycle, State, doubling_near
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.tones import Forcing

FORCING = Forcing.superposition(1)


def doubling_curve(close_at, second, gamma, cycle):
    """Gamma of a period doubling at each value of a second parameter, each found from the one before."""
    curve = []
    for value in second:
        gamma, cycle = doubling_near(close_at(float(value)), gamma, cycle, 0.2)
        curve.append(gamma)
    return np.array(curve)


def lock_and_doubling(e):
    """Closed forms of the locked 1-cycle with restitution, gamma."""
    lock = math.pi * (1 - e) / (1 + e)
    return lock / 2, math.sqrt(lock**2 + (2 * (1 + e * e) / (1 + e) ** 2) ** 2) / 2


def test_a_doubling_is_followed_in_the_restitution():
    """From e = 0.05 to 0.7 the curve is the closed form to 1e-9, where attractors coexist too."""
    second = np.linspace(0.05, 0.7, 27)
    gamma = lock_and_doubling(0.05)[1]
    ball = FrictionBall(FORCING, e0=0.05)
    cycle = ball.close(gamma, State(math.asin(0.6), 0.05 * 2 * math.pi / 1.05), 1)
    curve = doubling_curve(lambda e: FrictionBall(FORCING, e0=e).close, second, gamma, cycle)
    np.testing.assert_allclose(curve, [lock_and_doubling(e)[1] for e in second], rtol=0, atol=1e-9)


@pytest.mark.parametrize("e", [0.1, 0.5])
def test_a_locked_cycle_ends_at_a_fold_and_a_doubling(e):
    """Followed both ways from the middle, the locked 1-cycle's window is the closed forms' to 1e-9."""
    lock, doubling = lock_and_doubling(e)
    ball = FrictionBall(FORCING, e0=e)
    middle = 0.5 * (lock + doubling)
    start = State(math.acos(lock / middle), e * 2 * math.pi / (1 + e))
    cycle = ball.close(middle, start, 1)
    found = [follow(ball.close, middle, cycle, limit) for limit in (0.5 * lock, 2.0 * doubling)]
    assert [how for _, how in found] == ["fold", "period doubling"]
    np.testing.assert_allclose([gamma for gamma, _ in found], (lock, doubling), rtol=0, atol=1e-9)


def test_a_doubling_is_followed_in_the_second_tones_phase():
    """c = 2: along the curve every point is a doubling by its own multiplier."""
    at_zero = IdealBall(Forcing.superposition(2))
    gamma = 1.116165128878
    cycle = at_zero.close(gamma, State(at_zero.fly(gamma, State(), 300).last.phase), 1)
    phases = np.linspace(0.0, 0.3, 7)

    def close_at(phase):
        return IdealBall(Forcing.superposition(2, phase_rad=(0.0, phase))).close

    curve = doubling_curve(close_at, phases, gamma, cycle)
    assert np.all(np.isfinite(curve))
    assert curve[0] == pytest.approx(gamma, abs=1e-9)
    assert np.ptp(curve) > 1e-3


def test_a_multiplier_that_does_not_change_is_no_doubling() -> None:
    """Where the multiplier is the same at every gamma nothing is located, and nothing is divided by zero."""
    flat = LockedCycle(np.array([1.0]), np.array([0.0]), np.array([6.28]), np.array([1.0]), 1, -0.5)
    assert doubling_near(lambda gamma, state, n: flat, 2.0, flat, 1e-3) is None
