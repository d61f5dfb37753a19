"""Bifurcations: the published table to its digits, closed forms, brute force on either side, and nothing missed."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

from model.bifurcations.events import bifurcations, cycle_windows
from model.orbits.attractor import attractor
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.tones import Forcing

ONE_SINE = IdealBall(Forcing.superposition(1))
COARSE = 3e-3  # gamma: windows wide enough for a quick test


@pytest.fixture(scope="module")
def table():
    """Bifurcations of one sine up to gamma_peak 12, as (gamma_peak, event)."""
    return [(2.0 * b.gamma, b) for b in bifurcations(ONE_SINE, 0.4, 6.0, narrowest=COARSE)]


def at(table, peak, kind):
    """The event of ``kind`` at ``peak``."""
    found = [b for p, b in table if abs(p - peak) < 2e-9 * peak and b.type == kind]
    assert found, f"no {kind} at {peak}: {[(p, b.type) for p, b in table if abs(p - peak) < 0.02]}"
    return found[0]


@pytest.mark.parametrize("k", [1, 2, 3])
def test_locks_and_doublings_have_their_closed_forms(table, k):
    """The 1-cycle locks at sqrt(k^2 pi^2 + 1) and doubles at sqrt(k^2 pi^2 + 4), to 1e-9."""
    lock = at(table, math.sqrt((k * math.pi) ** 2 + 1), "lock")
    assert (lock.before.flights, lock.before.resets, lock.after.resets, lock.after.period) == (1, 1, 0, k)
    doubling = at(table, math.sqrt((k * math.pi) ** 2 + 4), "period doubling")
    assert (doubling.before.period, doubling.after.period) == (k, 2 * k)


@pytest.mark.parametrize(("peak", "k"), [(3.856854, 1), (6.669248, 2), (9.686410, 3)])
def test_the_two_cycle_starts_to_stick_where_published(table, peak, k):
    """A landing of the locked 2-cycle meets the threshold; the published digits."""
    found = [(p, b) for p, b in table if b.type == "stick gained" and b.after.flights == 2 and abs(p - peak) < 6e-7]
    assert len(found) == 1
    assert (found[0][1].before.resets, found[0][1].after.resets, found[0][1].after.period) == (0, 1, 2 * k)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_the_one_cycle_comes_back_where_a_forbidden_zone_is_born(table, k):
    """sqrt(1 + x^2) with tan x = x, to 1e-9: the cycle's second flight vanishes."""
    x = brentq(lambda x: math.sin(x) - x * math.cos(x), k * math.pi, (k + 0.5) * math.pi, xtol=1e-14)
    found = at(table, math.sqrt(1 + x * x), "flight lost")
    assert (found.before.flights, found.after.flights) == (2, 1)


def test_take_off_is_the_first_event(table):
    """The ball leaves at gamma_peak = 1."""
    assert table[0][1].type == "take-off"
    assert table[0][0] == pytest.approx(1.0, abs=1e-12)


def test_the_published_accumulation_is_named():
    """The reset flight lands on the unstable 2 pi point at gamma_peak = 7.253378606."""
    found = bifurcations(ONE_SINE, 3.62, 3.635, narrowest=2e-4)
    peaks = [2 * b.gamma for b in found if b.type == "accumulation"]
    assert any(abs(p - 7.253378606) < 6e-10 for p in peaks)


@pytest.mark.parametrize(
    ("c", "levels"), [(2, [(0.2117715, "take-off"), (0.302184, "new take-off window")]), (3, [(0.1052122, "take-off")])]
)
def test_take_off_windows_open_where_published(c, levels):
    """Two tones: take-off, and at c = 2 the second window, to the digits given."""
    found = bifurcations(IdealBall(Forcing.superposition(c)), 0.05, 0.35, narrowest=1e-2)
    for gamma, kind in levels:
        assert any(b.type == kind and abs(b.gamma - gamma) < 6e-7 for b in found)


@pytest.mark.parametrize("c", [1, 2, 3])
def test_every_event_is_seen_by_brute_force(c):
    """Just below and above each event the orbit from rest has the flights, resets and period that the event says."""
    ball = IdealBall(Forcing.superposition(c))
    checked = 0
    for event in bifurcations(ball, 0.4, 2.4, narrowest=COARSE):
        if event.type == "accumulation":
            continue
        for side, gamma in ((event.before, event.gamma - 1e-9), (event.after, event.gamma + 1e-9)):
            if side.period is None or (side.flights or 0) > 4:
                continue
            found = attractor(ball, gamma)
            assert (found.period, found.flights, found.resets) == (side.period, side.flights, side.resets), event
            checked += 1
    assert checked > 8


@pytest.mark.parametrize("c", [1, 2, 3])
def test_no_window_is_missed(c):
    """Random gammas: whatever short cycle is there lies in a listed window, unless its own window is narrow."""
    ball = IdealBall(Forcing.superposition(c))
    windows = cycle_windows(ball, 1.0, 2.4, narrowest=1e-4)
    rng = np.random.default_rng(5)
    outside = 0
    for gamma in rng.uniform(1.0, 2.4, 400):
        inside = [w for w in windows if w.low <= gamma <= w.high]
        found = attractor(ball, float(gamma))
        if inside:
            window = inside[0]
            assert (found.flights, found.resets, found.period) == (window.flights, window.resets, window.period)
            continue
        outside += 1
        near = [attractor(ball, float(gamma + d)) for d in np.linspace(-1e-4, 1e-4, 21)]
        assert any((n.flights, n.period) != (found.flights, found.period) or n.resets != found.resets for n in near)
    assert outside < 40


def test_a_locked_cycle_is_followed_to_where_it_sticks():
    """At c = 3 the locked 2-cycle begins where the orbits from rest stop sticking, whatever branch it lands in."""
    ball = IdealBall(Forcing.superposition(3))
    lock = next(b for b in bifurcations(ball, 0.45, 0.55, narrowest=1e-4) if b.type == "lock")
    below, above = (attractor(ball, lock.gamma + d) for d in (-1e-11, 1e-11))
    assert (below.flights, below.resets, above.flights, above.locked) == (2, 1, 2, True)


def test_windows_do_not_overlap():
    """Each gamma belongs to at most one window, and they come in order."""
    windows = cycle_windows(ONE_SINE, 3.5, 4.0, narrowest=1e-4)
    assert len(windows) > 3
    for left, right in pairwise(windows):
        assert left.high <= right.low + 1e-12


@pytest.mark.parametrize("mu", [0.1, 0.3])
def test_friction_moves_lock_and_doubling(mu):
    """Friction, e = 0: at 0.3 lock and doubling are where published; the events are where brute force says."""
    ball = FrictionBall(Forcing.superposition(1), mu, mu)
    found = {b.type: b for b in bifurcations(ball, 0.5, 2.28, narrowest=1e-2)}
    if mu == 0.3:
        assert 2 * found["lock"].gamma == pytest.approx(4.0564, abs=6e-5)
        assert 2 * found["period doubling"].gamma == pytest.approx(4.507, abs=1.1e-3)
    assert found["take-off"].gamma == pytest.approx((1 + mu) / 2, abs=1e-12)
    below, above = (attractor(ball, found["lock"].gamma + d) for d in (-1e-9, 1e-9))
    assert (below.locked, above.locked) == (False, True)
    below, above = (attractor(ball, found["period doubling"].gamma + d) for d in (-1e-6, 1e-6))
    assert (below.flights, above.flights) == (1, 2)


@pytest.mark.parametrize("e", [0.05, 0.1, 0.2])
def test_restitution_locks_and_doubles_at_its_closed_forms(e):
    """k pi (1-e)/(1+e) and its doubling [..]^2 + [2 (1+e^2)/(1+e)^2]^2, to 1e-9."""
    lock = math.pi * (1 - e) / (1 + e)
    doubling = math.sqrt(lock**2 + (2 * (1 + e * e) / (1 + e) ** 2) ** 2)
    ball = FrictionBall(Forcing.superposition(1), e0=e)
    found = bifurcations(ball, 0.97 * doubling / 2, 1.01 * doubling / 2, narrowest=1e-3)
    assert any(b.type == "period doubling" and abs(2 * b.gamma - doubling) < 2e-9 for b in found)
    if e < 0.1:  # with more bounce the orbit from rest still chatters there
        found = bifurcations(ball, 0.99 * lock / 2, 1.01 * lock / 2, narrowest=1e-4)
        assert any(b.type == "lock" and abs(2 * b.gamma - lock) < 2e-9 for b in found)


def test_a_senseless_range_is_refused():
    """A range upside down is an error."""
    with pytest.raises(ValueError, match="range"):
        bifurcations(ONE_SINE, 2.0, 1.0)
