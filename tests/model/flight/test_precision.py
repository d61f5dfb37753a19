"""Amplitudes beyond what double precision proves are refused, and below them landings are as good as promised."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from benchmarks.model.first_landing import FlightFlag, first_landing, take_off_phases
from model.bifurcations.events import bifurcations
from model.flight.windows import PROVEN_PHASE, largest_gamma
from model.orbits.attractor import attractor
from model.orbits.exact_ball import IdealBall
from model.orbits.make_ball import make_ball
from model.surveys.diagram import diagram
from model.tones import Forcing


@pytest.mark.parametrize("c", [1, 3, 20])
def test_landings_at_the_largest_gamma_are_within_the_promise(c: int) -> None:
    """Against sums of 40 digits, landings at the largest gamma err by less than what is promised."""
    forcing = Forcing.superposition(c)
    gamma = largest_gamma(forcing)
    windows = take_off_phases(forcing, gamma)
    tones = [(n, b, p) for n, b, p in forcing.tones.tolist()]
    for phase in np.linspace(windows.start[0], windows.stop[0], 9)[1:-1].tolist():
        landing = first_landing(forcing, gamma, phase)
        if landing.flag & FlightFlag.UNDECIDED:
            continue
        start = mpmath.mpf(phase)
        with mpmath.workdps(40):

            def height(tau, start=start):
                moved = [
                    b
                    * (
                        mpmath.sin(n * start + p)
                        + n * tau * mpmath.cos(n * start + p)
                        - mpmath.sin(n * (start + tau) + p)
                    )
                    for n, b, p in tones
                ]
                return gamma * mpmath.fsum(moved) - tau * tau / 2

            exact = mpmath.findroot(height, (mpmath.mpf(landing.tau), mpmath.mpf(landing.tau) + 1e-12))
            assert abs(exact - landing.tau) < PROVEN_PHASE


@pytest.mark.parametrize("effects", [{}, {"restitution": {"e0": 0.5}}, {"viscous_damping": {"rate_per_s": 0.1}}])
def test_every_ball_refuses_a_gamma_beyond_the_proven(effects: dict[str, dict[str, float]]) -> None:
    """The ideal, the bouncing and the integrated ball name the largest gamma instead of answering with noise."""
    ball = make_ball(Forcing.superposition(1), effects, frequency_hz=25.0)
    for ask in (lambda: attractor(ball, 1e300), lambda: diagram(ball, [0.9, 1e5])):
        with pytest.raises(ValueError, match=r"gamma = .* on this plate"):
            ask()


def test_a_ratio_beyond_the_proven_sine_is_refused() -> None:
    """c = 1,000,000 is refused at once, with the largest c."""
    with pytest.raises(ValueError, match=r"the sine of a phase is proven up to .*, which is c = 79577"):
        attractor(IdealBall(Forcing.superposition(1_000_000)), 1e-11)


@pytest.mark.parametrize(("high", "narrowest"), [(1e300, 1e-6), (3.0, 1e-13), (3.0, 0.0)])
def test_a_search_for_bifurcations_without_end_is_refused(high: float, narrowest: float) -> None:
    """A range too wide for its narrowest window, or a window of no width, is refused before any search."""
    with pytest.raises(ValueError, match=r"narrower range|wider than 0"):
        bifurcations(IdealBall(Forcing.superposition(1)), 0.5, high, narrowest=narrowest)
