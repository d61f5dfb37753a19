"""No wrong landing: the ideal kernels against 60 digits and against a proof by interval bisection."""

import itertools
import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.model.adversarial import HEIGHT_ROUNDING, KINDS, allowed, flights_of
from benchmarks.model.first_landing import FlightFlag, first_landing, take_off_phases
from benchmarks.model.reference import Exact, lifted_until, stays_above
from model.orbits.attractor import AT_REST
from model.orbits.exact_ball import IdealBall
from model.tones import Forcing, relative_height


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_landing_is_the_first_to_60_digits(kind):
    """Adversarial flights land where the 60-digit solver lands, to the rounding of the height."""
    flights = flights_of(kind, np.random.default_rng(11), per_forcing=2)
    for forcing, gamma, phi0, v0, at_threshold in itertools.islice(flights, 1 if kind == "long" else 8):
        landing = first_landing(forcing, gamma, phi0, v0)
        if landing.flag & FlightFlag.UNDECIDED:
            continue
        exact = Exact(forcing, gamma)
        start = exact.threshold_near(phi0) if at_threshold else mp.mpf(phi0)
        tau = float(exact.landing(start, v0) - start)
        # just above take-off the window's width, and with it tau, is the square root of what gamma is above
        slack = 1e-9 if kind == "threshold" else 0.0
        assert landing.tau == pytest.approx(tau, abs=slack + allowed(gamma, forcing, tau, landing.impact_speed))


@pytest.mark.parametrize("kind", ["graze", "bounce", "long", "tones", "take-off"])
def test_nothing_touches_the_plate_before_the_landing(kind):
    """Interval bisection proves the flight free until just before its landing, and below just after it."""
    flights = itertools.islice(flights_of(kind, np.random.default_rng(3)), 400)
    undecided = too_near = 0
    for forcing, gamma, phi0, v0, at_threshold in flights:
        landing = first_landing(forcing, gamma, phi0, v0)
        tau = landing.tau
        undecided += bool(landing.flag & FlightFlag.UNDECIDED)
        if landing.flag & FlightFlag.UNDECIDED or tau < 1e-3:  # shorter ones: to 60 digits, above
            continue
        margin = 1e-7 + 2 * allowed(gamma, forcing, tau, landing.impact_speed)
        noise = 2 * HEIGHT_ROUNDING * (gamma * forcing.tones[:, 1].sum() * (1 + 7 * tau) + tau**2)
        lifted = lifted_until(forcing, gamma, phi0, v0, at_threshold)
        assert lifted < tau + margin
        free = stays_above(forcing.tones, gamma, phi0, v0, min(lifted, tau - margin), tau - margin, noise)
        assert free != 0
        too_near += free < 0
        assert relative_height(forcing, gamma, phi0, tau + margin, v0) <= noise
    assert undecided + too_near <= (8 if kind == "graze" else 0)


def test_orbits_are_made_of_first_landings():
    """Every flight of whole orbits, c = 1, 2, 3 and 7, flown alone from its take-off, lands at the same phase."""
    for ratio, lowest in ((1, 0.51), (2, 0.22), (3, 0.11), (7, 0.0205)):
        forcing = Forcing.superposition(ratio)
        for gamma in lowest * np.geomspace(1, 100 if ratio == 7 else 20, 60):
            path = IdealBall(forcing).fly(gamma, AT_REST, 60)
            for tau, phi, speed in zip(path.tau, path.phase, path.speed, strict=True):
                assert abs(first_landing(forcing, gamma, phi).tau - tau) <= allowed(gamma, forcing, tau, speed)


def test_a_closed_orbit_goes_round():
    """After the last flight of a cycle the ball rests until the very threshold from which the cycle began."""
    closed = 0
    for ratio in (1, 2, 3):
        forcing = Forcing.superposition(ratio)
        for gamma in np.linspace(0.55, 6, 50):
            path = IdealBall(forcing).fly(gamma, AT_REST, 300)
            if path.first < 0:
                continue
            closed += 1
            windows = take_off_phases(forcing, gamma)
            landing = path.phase[-1] + path.tau[-1]
            assert not np.any(np.mod(landing - windows.start, 2 * np.pi) < windows.stop - windows.start - 1e-9)
            waits = np.mod(windows.start - landing, 2 * np.pi)
            following = windows.start[np.argmin(waits)]
            assert math.remainder(following - path.phase[path.first], 2 * np.pi) == pytest.approx(0.0, abs=1e-12)
    assert closed > 100


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(
    harmonics=st.lists(st.integers(1, 7), min_size=1, max_size=4, unique=True),
    data=st.data(),
    gamma=st.floats(1e-3, 50),
    turn=st.floats(0, 6.283),
    v0=st.one_of(st.just(0.0), st.floats(1e-9, 20)),
)
def test_any_flight_starts_and_ends_on_the_plate(harmonics, data, gamma, turn, v0):
    """Whatever the tones, a flight is finite and ends at height zero, and only a window lifts a ball at rest."""
    size = len(harmonics)
    amplitude = tuple(data.draw(st.lists(st.floats(0, 1), min_size=size, max_size=size)))
    phase = tuple(data.draw(st.lists(st.floats(0, 6.283), min_size=size, max_size=size)))
    forcing = Forcing(tuple(map(float, harmonics)), amplitude, phase)
    landing = first_landing(forcing, gamma, turn, v0)
    windows = take_off_phases(forcing, gamma)
    inside = bool(np.any((windows.start - 1e-9 <= turn) & (turn < windows.stop))) or bool(
        np.any((windows.start - 1e-9 <= turn + 2 * np.pi) & (turn + 2 * np.pi < windows.stop))
    )
    if landing.flag & FlightFlag.RESTS:
        assert v0 == 0.0
        assert landing.tau == 0.0
        return
    assert v0 > 0.0 or inside
    assert np.isfinite(landing.tau)
    assert landing.impact_speed >= 0.0
    height = relative_height(forcing, gamma, turn, landing.tau, v0)
    assert abs(height) <= 1e-12 * (1 + gamma * np.sum(forcing.tones[:, 1] * (1 + forcing.tones[:, 0])) + landing.tau**2)


@pytest.mark.parametrize(
    "forcing", [Forcing((), (), ()), Forcing.superposition(1, (1.0, -1.0)), Forcing((2.0,), (0.0,), (0.0,))]
)
def test_no_motion_is_no_flight(forcing):
    """Without tones, with tones of amplitude zero, or with equal opposite ones, the ball rests; a bounced one falls."""
    assert not forcing.moves
    assert take_off_phases(forcing, 5.0).start.size == 0
    assert first_landing(forcing, 5.0, 1.0).flag is FlightFlag.RESTS
    assert first_landing(forcing, 5.0, 1.0, v0=0.5).tau == pytest.approx(1.0, abs=1e-15)
    for gamma in (0.0, 1.0, 50.0):
        assert IdealBall(forcing).fly(gamma, AT_REST, 4).tau.size == 0


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda f: first_landing(f, -1.0, 0.0), "gamma"),
        (lambda f: first_landing(f, float("nan"), 0.0), "gamma"),
        (lambda f: first_landing(f, 1.0, 0.0, v0=-1.0), "v0"),
        (lambda f: first_landing(f, 1.0, float("inf")), "phi0"),
        (lambda f: Forcing((0.0,), (1.0,), (0.0,)), "positive"),
        (lambda f: Forcing((1.0, 2.0), (1.0,), (0.0,)), "equal lengths"),
        (lambda f: Forcing((1.0,), (float("nan"),), (0.0,)), "finite"),
    ],
)
def test_nonsense_is_refused(call, word):
    """An argument without meaning is an error that names it."""
    with pytest.raises(ValueError, match=word):
        call(Forcing.superposition(1))


@settings(max_examples=50, deadline=None)
@given(st.floats(0.1, 20), st.floats(0, 6.283), st.floats(-0.9, 0.9))
def test_shifting_the_origin_of_phase_changes_nothing(gamma, shift, where):
    """A forcing delayed by a phase has the same flight delayed by it."""
    plain, moved = Forcing.superposition(3), Forcing((1.0, 3.0), (1.0, 1.0), (-shift, -3 * shift))
    windows = take_off_phases(plain, gamma)
    if windows.start.size == 0 or np.min(windows.stop - windows.start) < 1e-3:
        return
    phi0 = windows.start[0] + (0.05 + 0.9 * abs(where)) * (windows.stop[0] - windows.start[0])
    one, other = first_landing(plain, gamma, phi0), first_landing(moved, gamma, phi0 + shift)
    if min(one.impact_speed, other.impact_speed) > 1e-3:
        assert one.tau == pytest.approx(other.tau, abs=1e-9)
