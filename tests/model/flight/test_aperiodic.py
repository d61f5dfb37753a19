"""Tones without a common period: the same flights, proven by the same means."""

import math

import numpy as np
import pytest

from benchmarks.model.reference import stays_above
from model.flight.first_landing import (
    FlightFlag,
    first_landing,
    relative_height,
    run_diagram,
    run_orbit,
    take_off_phases,
)
from model.tones import Forcing


@pytest.mark.slow
def test_a_period_in_disguise():
    """Tones at half the phase speed, a half-integer and an integer, give the same flights in twice the phase."""
    whole, halves = Forcing.superposition(2), Forcing((0.5, 1.0), (1.0, 1.0), (0.0, 0.0))
    for gamma in (0.3, 1.28, 3.0):
        one = run_orbit(whole, gamma, 0, 20)
        two = run_orbit(halves, 4 * gamma, 0, 20)  # the same acceleration at half the phase speed
        assert two.tau[:8] == pytest.approx(2 * one.tau[:8], abs=1e-9)
        assert np.array_equal(one.flag[:8], two.flag[:8])


def test_incommensurate_flights_are_first_landings():
    """With tones in an irrational ratio no point of the flight before the landing touches the plate."""
    forcing = Forcing((1.0, math.sqrt(2), 2.7), (1.0, 0.6, 0.3), (0.1, 2.0, 4.0))
    gammas = np.linspace(0.4, 6, 30)
    orbit = run_diagram(forcing, gammas, 5, 30)
    for gamma, taus, phases, flags in zip(gammas, orbit.tau, orbit.takeoff_phase, orbit.flag, strict=True):
        assert not np.any(flags & (FlightFlag.RESTS | FlightFlag.UNDECIDED))
        for tau, phi in zip(taus, phases, strict=True):
            if tau > 0.1:
                assert stays_above(forcing.tones, gamma, phi, 0.0, 0.05 * tau, tau - 1e-6, 1e-10) != 0
            assert abs(relative_height(forcing, gamma, phi, tau)) < 1e-10


def test_single_flights_and_rest():
    """One flight repeats the orbit's; below every tone's reach the ball rests; a period is not pretended."""
    forcing = Forcing((1.0, math.pi), (1.0, 0.2), (0.0, 0.0))
    orbit = run_orbit(forcing, 0.9, 0, 5)
    for tau, phi in zip(orbit.tau, orbit.takeoff_phase, strict=True):
        assert first_landing(forcing, 0.9, phi).tau == pytest.approx(tau, abs=1e-12)
    assert run_orbit(forcing, 0.1, 0, 2).flag[0] == FlightFlag.RESTS
    assert first_landing(forcing, 0.1, 0.3).flag is FlightFlag.RESTS
    assert first_landing(forcing, 0.1, 0.3, v0=0.2).tau > 0.3
    with pytest.raises(ValueError, match="period"):
        take_off_phases(forcing, 1.0)
