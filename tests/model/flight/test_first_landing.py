"""The exact ideal flight against the values of the literature."""

import numpy as np
import pytest

from benchmarks.model.every_flight import every_flight
from benchmarks.model.first_landing import FlightFlag, first_landing, take_off_phases
from model.orbits.exact_ball import IdealBall
from model.tones import Forcing

ONE = Forcing.superposition(1)


@pytest.mark.parametrize(
    ("gamma_peak", "taus"),
    [
        (1.1, (1.741151,)),
        (1.5, (3.566217,)),
        (2.0, (4.658851,)),
        (3.0, (5.967608,)),
        (3.8, (6.742421, 5.823950)),
        (4.0, (7.058725, 5.320300)),
    ],
)
def test_published_flight_times_of_one_sine(gamma_peak, taus):
    """The settled orbit at one sine repeats the published flight times, to every digit given."""
    orbit = every_flight(IdealBall(ONE), gamma_peak / 2, 100, 2 * len(taus))
    assert orbit.tau == pytest.approx(np.tile(taus, 2), abs=6e-7)


def test_the_papers_figure_1():
    """c = 2 at gamma 1.28 is the paper's 3-cycle, with its three flight times."""
    orbit = every_flight(IdealBall(Forcing.superposition(2)), 1.28, 100, 3)
    assert orbit.tau == pytest.approx([2.506845, 2.758548, 7.053544], abs=1e-6)
    assert list(orbit.reset) == [False, False, True]


@pytest.mark.parametrize(("ratio", "gamma", "windows"), [(2, 0.2117715, 1), (2, 0.302184, 2), (3, 0.1052122, 2)])
def test_windows_open_where_they_should(ratio, gamma, windows):
    """A take-off window opens within the last digit of the published amplitude."""
    forcing = Forcing.superposition(ratio)
    step = 1e-6 if ratio == 2 else 1e-7
    before = take_off_phases(forcing, gamma - step).start.size
    assert take_off_phases(forcing, gamma + step).start.size == windows
    assert before < windows


def test_tones_without_a_common_period_are_refused():
    """A plate that never repeats has no table of windows: the harmonics are named."""
    with pytest.raises(ValueError, match="not all integers"):
        first_landing(Forcing((1.0, 2.5), (1.0, 0.2), (0.0, 0.0)), 0.9, 0.3)


def test_resting_ball_stays():
    """Outside every window a ball without speed rests, and a bounced one flies."""
    assert first_landing(ONE, 0.4, 0.0).flag is FlightFlag.RESTS
    assert first_landing(ONE, 2.0, 4.0).tau == 0.0
    assert first_landing(ONE, 0.4, 0.0, v0=0.1).tau > 0.2
