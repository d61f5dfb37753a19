"""Orbits: cycles against published values, an independent slow solver and the locked cycle's own formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from model.orbits.attractor import Attractor, State, attractor, sweep
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.orbits.make_ball import make_ball
from model.tones import Forcing

ONE_SINE = IdealBall(Forcing.superposition(1))
STEP = 2e-3  # of the slow solver's march


def same_attractor(one: Attractor, other: Attractor, tolerance: float = 1e-6) -> bool:
    """Whether two attractors at one gamma are the same, wherever their cycles are entered."""
    if (one.kind, one.period, one.flights, one.resets) != (other.kind, other.period, other.flights, other.resets):
        return False
    if one.kind == "chaotic" or one.flights == 0:
        return True
    return any(bool(np.all(np.abs(np.roll(one.tau, k) - other.tau) < tolerance)) for k in range(one.flights))


def slow_landing(c, gamma, p0):
    """First landing by marching in small steps and bisecting: independent of the kernels, blind to narrow grazes."""

    def height(p):
        plate = math.sin(p0) + math.sin(c * p0) - math.sin(p) - math.sin(c * p)
        return gamma * plate + gamma * (math.cos(p0) + c * math.cos(c * p0)) * (p - p0) - 0.5 * (p - p0) ** 2

    p = p0 + 5 * STEP
    while height(p) > 0.0:
        p += STEP
    return brentq(height, p - STEP, p, xtol=1e-13)


def slow_cycle(c, gamma, flights):
    """The last ``flights`` flight times of an orbit from rest at phase 0."""

    def lift(p):
        return gamma * (math.sin(p) + c * c * math.sin(c * p)) - 1.0

    phase, taus = 0.0, []
    for _ in range(60 + flights):
        if lift(phase) < 0.0:
            while lift(phase) < 0.0:
                phase += STEP
            phase = brentq(lift, phase - STEP, phase, xtol=1e-14) + 1e-13
        landing = slow_landing(c, gamma, phase)
        taus.append(landing - phase)
        phase = landing % (2 * math.pi)
    return taus[-flights:]


@pytest.mark.parametrize(
    ("peak", "tau"),
    [(1.1, 1.741151), (1.5, 3.566217), (2.0, 4.658851), (3.0, 5.967608)],
)
def test_the_reset_flight_has_the_published_time(peak, tau):
    """One sine: the flight from rest lasts as long as published, to the digits given."""
    found = attractor(ONE_SINE, peak / 2)
    assert (found.flights, found.resets, found.period, found.locked) == (1, 1, 1, False)
    assert found.tau[0] == pytest.approx(tau, abs=6e-7)


@pytest.mark.parametrize(("peak", "taus"), [(3.8, (6.742421, 5.823950)), (4.0, (7.058725, 5.320300))])
def test_the_two_cycle_has_the_published_times(peak, taus):
    """One sine: the locked and the resting 2-cycle have the published flight times."""
    found = attractor(ONE_SINE, peak / 2)
    assert found.locked == (peak < 3.85)
    np.testing.assert_allclose(found.tau, taus, atol=6e-7)


def test_the_papers_first_figure_is_a_three_cycle():
    """c = 2, gamma = 1.28: three flights in two periods, one of them from rest; the reset flight comes first."""
    found = attractor(IdealBall(Forcing.superposition(2)), 1.28)
    assert (found.kind, found.period, found.flights, found.resets) == ("periodic", 2, 3, 1)
    np.testing.assert_allclose(found.tau, [7.053544, 2.506845, 2.758548], atol=6e-7)


@pytest.mark.parametrize(
    ("c", "gamma"), [(1, 2.6), (1, 3.7), (1, 5.2), (2, 0.5), (2, 1.45), (2, 2.3), (3, 0.3), (3, 0.9)]
)
def test_cycles_agree_with_a_slow_solver(c, gamma):
    """Values published nowhere agree with a march in small steps that shares no code with the kernels."""
    found = attractor(IdealBall(Forcing.superposition(c)), gamma)
    slow = slow_cycle(c, gamma, found.flights)
    assert any(np.allclose(np.roll(found.tau, k), slow, atol=1e-7) for k in range(found.flights))


@pytest.mark.parametrize("peak", [3.35, 3.5, 3.7])
def test_the_locked_cycle_has_its_multiplier(peak):
    """Locked at tau = 2 pi: sin(phase) follows from cos(phase) = pi / peak, and the multiplier from both."""
    found = attractor(ONE_SINE, peak / 2)
    sine = math.sqrt(1.0 - (math.pi / peak) ** 2)
    assert found.phase[0] == pytest.approx(math.asin(sine), abs=1e-12)
    # T' = -tau h''(take-off) / impact speed, and the impact speed of a locked flight is tau
    assert found.multiplier == pytest.approx(1.0 - peak * sine, abs=1e-10)


@pytest.mark.parametrize("offset", [-1e-4, -1e-6, 1e-6, 1e-4])
def test_slow_orbits_beside_a_doubling_are_named(offset):
    """Where an orbit converges for longer than it is flown, the cycle is still the right one on either side."""
    found = attractor(ONE_SINE, (math.sqrt(math.pi**2 + 4) + offset) / 2)
    assert (found.locked, found.flights) == (True, 1 if offset < 0 else 2)


def test_below_take_off_there_is_no_flight():
    """A plate that never lifts the ball is reported as the plain motion with the plate: period 1, no flights."""
    found = attractor(ONE_SINE, 0.49)
    assert (found.kind, found.period, found.flights, found.tau.size) == ("periodic", 1, 0, 0)


@pytest.mark.parametrize("gamma", [-1.0, math.nan, math.inf])
def test_a_senseless_gamma_is_refused(gamma):
    """Negative and non-finite amplitudes are errors, not orbits."""
    with pytest.raises(ValueError, match="gamma"):
        attractor(ONE_SINE, gamma)


@pytest.mark.parametrize("gamma", [12.5, 25.0, 50.0])
def test_long_flights_close(gamma):
    """Up to gamma = 50 the flight from rest agrees with the slow solver."""
    found = attractor(ONE_SINE, gamma)
    first = slow_landing(1, gamma, math.asin(0.5 / gamma) + 1e-13) - math.asin(0.5 / gamma)
    assert found.tau[0] == pytest.approx(first, abs=1e-7)


def test_friction_and_restitution_with_nothing_in_them_change_nothing():
    """The rough kernel at zero friction and restitution closes on the ideal cycles."""
    for c, gamma in ((1, 1.9), (1, 3.65), (2, 1.28), (3, 0.5)):
        forcing = Forcing.superposition(c)
        assert same_attractor(attractor(IdealBall(forcing), gamma), attractor(FrictionBall(forcing), gamma), 1e-9)


def test_chaos_has_a_positive_exponent_or_none():
    """Beyond the doublings of restitution 0.05 the orbit from rest does not close and is called chaotic."""
    found = attractor(FrictionBall(Forcing.superposition(1), e0=0.05), 3.69 / 2)
    assert (found.kind, found.period, found.multiplier) == ("chaotic", None, None)
    assert found.tau.size == found.flights > 0


def test_a_chatter_is_named():
    """Slow restitution: the bounces shrink to nothing before the next threshold, once a period."""
    found = attractor(FrictionBall(Forcing.superposition(1), e0=0.3), 0.7)
    assert (found.kind, found.period, found.resets) == ("chattering", 1, 1)
    assert np.all(np.diff(found.tau) < 0.0)


def test_up_and_down_ramps_differ_where_attractors_coexist():
    """Restitution 0.3: the ramp up still chatters where the ramp down is still locked."""
    ball = FrictionBall(Forcing.superposition(1), e0=0.3)
    gammas = np.linspace(0.55, 1.2, 40)
    up = sweep(ball, gammas)
    down = sweep(ball, gammas[::-1])[::-1]
    differ = [not same_attractor(a, b) for a, b in zip(up, down, strict=True)]
    assert 10 < sum(differ) < 30
    middle = int(np.flatnonzero(differ)[len(np.flatnonzero(differ)) // 2])
    assert (up[middle].locked, down[middle].locked) == (False, True)


def test_an_integrated_ball_agrees_with_the_exact_one():
    """The general ball with a vanishing extra effect flies the exact ball's cycle to the integration's tolerance."""
    forcing = Forcing.superposition(1)
    exact = attractor(make_ball(forcing, {"coulomb_friction": {"mu": 0.3}}), 1.5)
    both = {"coulomb_friction": {"mu": 0.3}, "viscous_damping": {"rate_per_s": 1e-9}}
    rolled = attractor(make_ball(forcing, both, frequency_hz=20.0), 1.5)
    assert (rolled.flights, rolled.resets, rolled.period) == (exact.flights, exact.resets, exact.period)
    np.testing.assert_allclose(rolled.tau, exact.tau, atol=1e-5)


def test_a_start_in_flight_is_flown():
    """A ball thrown off the plate ends on the same cycle as one put down, where there is only one."""
    thrown = attractor(ONE_SINE, 1.5, State(1.0, 4.0))
    assert same_attractor(thrown, attractor(ONE_SINE, 1.5))
