"""What the contact circuit shows of exact flights."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmarks.model.every_flight import every_flight
from model.orbits.contact_sensor import Instrument, observe
from model.orbits.exact_ball import IdealBall
from model.tones import Forcing

GAP_PS = st.integers(1_000_000, 5_000_000_000) | st.integers(1, 100).map(lambda samples: 50_000_000 * samples)
EVENTS = st.lists(st.floats(1e-6, 5e-3), min_size=2, max_size=40).filter(lambda gaps: len(gaps) % 2 == 0)


def scan(takeoff_ps, landing_ps, closure_ps):
    """Brute force in whole picoseconds, where events can lie on samples: the level of every sample, then its edges."""
    sample_ps = 50_000_000  # 20 kHz
    n = sample_ps * np.arange(landing_ps[-1] // sample_ps + 3)
    opened = takeoff_ps.copy()
    opened[1:] = np.maximum(opened[1:], landing_ps[:-1] + closure_ps)
    level = ((n[:, None] >= opened) & (n[:, None] < landing_ps)).any(axis=1)
    step = np.flatnonzero(np.diff(level.astype(int)))
    return n[step[::2] + 1] / 1e12, n[step[1::2] + 1] / 1e12


@settings(max_examples=60, deadline=None)
@given(st.lists(GAP_PS, min_size=2, max_size=40), st.sampled_from([0, 200_000_000, 1_000_000_000]))
@example([5_000_000_000, 5_000_000_000, 150_000_000, 3_906_250_000], 0)
def test_every_sample_agrees_with_a_scan(gaps_ps, closure_ps):
    """Visible flights are those of a sample-by-sample scan, whatever the events and the closure after an impact."""
    times_ps = np.cumsum(gaps_ps[: len(gaps_ps) // 2 * 2])
    times_s = times_ps / 1e12
    seen = observe(times_s[::2], times_s[1::2], Instrument(closure_s=closure_ps / 1e12))
    takeoff_s, landing_s = scan(times_ps[::2], times_ps[1::2], closure_ps)
    assert seen.takeoff_s == pytest.approx(takeoff_s, abs=1e-12)
    assert seen.landing_s == pytest.approx(landing_s, abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(EVENTS, st.sampled_from([0.0, 5e-4, 2e-3]), st.sampled_from([0.0, 8e-4]), st.integers(0, 99))
def test_no_flight_is_dropped_silently(gaps, dead_time_s, bounce_s, seed):
    """Every exact flight is either alone in a visible one or listed as hidden, and reports keep the dead time."""
    times = np.cumsum(gaps)
    instrument = Instrument(dead_time_s=dead_time_s, bounce_s=bounce_s)
    seen = observe(times[::2], times[1::2], instrument, rng=np.random.default_rng(seed))
    alone = seen.first[(seen.first == seen.last) & (seen.first >= 0)]
    assert sorted([*alone, *seen.hidden]) == list(range(times.size // 2))
    edges = np.column_stack([seen.takeoff_s, seen.landing_s]).ravel()
    assert np.all(np.diff(edges) >= max(dead_time_s, 1 / 20000) - 1e-9)
    assert np.all(seen.last >= seen.first)


def test_relaunch_hides_the_contact():
    """At one sine where flights relaunch where they land, no contact is seen and all flights merge into one."""
    orbit = every_flight(IdealBall(Forcing.superposition(1)), 1.75, 20, 50)
    end = np.cumsum(orbit.tau) / (2 * np.pi * 25)
    seen = observe(np.concatenate([[0.0], end[:-1]]), end, Instrument())
    assert list(seen.first) == [0]
    assert list(seen.last) == [49]
    assert seen.merged.all()
    assert seen.hidden.size == 50


def test_a_closure_shows_the_relaunch():
    """The same flights are told apart when the impact closes the circuit for half a millisecond."""
    orbit = every_flight(IdealBall(Forcing.superposition(1)), 1.75, 20, 50)
    end = np.cumsum(orbit.tau) / (2 * np.pi * 25)
    seen = observe(np.concatenate([[0.0], end[:-1]]), end, Instrument(closure_s=5e-4))
    assert list(seen.first) == list(range(50))
    assert seen.hidden.size == 0


def test_dead_time_swallows_a_short_contact():
    """A contact of 1 ms survives sampling but not a dead time of 2 ms."""
    takeoff, landing = np.array([0.0, 0.031]), np.array([0.03, 0.06])
    assert observe(takeoff, landing, Instrument()).first.size == 2
    seen = observe(takeoff, landing, Instrument(dead_time_s=2e-3))
    assert (list(seen.first), list(seen.last)) == ([0], [1])


def test_misuse_is_refused():
    """Events out of order, a bouncing contact without randomness and a negative time are errors."""
    with pytest.raises(ValueError, match="in order"):
        observe([0.0, 0.01], [0.02, 0.03], Instrument())
    with pytest.raises(ValueError, match="rng"):
        observe([0.0], [0.02], Instrument(bounce_s=1e-3))
    with pytest.raises(ValueError, match="dead_time_s"):
        Instrument(dead_time_s=-1.0)
