"""A ball that rebounds: chains of impacts, chatter whose bounces were not seen, grazes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.prediction_errors import held_out_errors, near_grazing, noise_floors_us, scored_rows
from model.effects.registry import row
from model.integrator.one_step import one_ahead, simulate
from model.integrator.problem import Detection, Measured, PlateSteps
from model.integrator.takeoff import RESOLVED_S
from model.tones import Plate

G = 9.80665
E0 = 0.4
PERIOD_S = 0.04
OMEGA = 2.0 * np.pi / PERIOD_S
REBOUNDS = {("restitution", "e0"): 0.5}


def moving(gamma: float) -> PlateSteps:
    """One step of a plate that moves as a sine."""
    return PlateSteps(np.array([[OMEGA]]), np.array([[gamma * G + 0j]]), np.array([PERIOD_S]))


def tones_of(plate: PlateSteps) -> Plate:
    """The first step's tones."""
    return Plate(plate.omega_radps[0], plate.acceleration_mps2[0])


def table(landing_s: np.ndarray, opening_s: np.ndarray, relaunched: np.ndarray, wanted: np.ndarray) -> Measured:
    """Flights of one step, each linked to the one before."""
    linked = np.arange(len(landing_s)) > 0
    return Measured(opening_s, landing_s, relaunched & linked, linked, np.zeros(len(landing_s), np.int64), wanted)


def test_the_first_prediction_of_a_step_knows_the_impact_before() -> None:
    """Wherever predictions begin to be wanted in an elastic orbit, the first ones hit as all the others do."""
    plate = moving(1.9)
    orbit = simulate(
        {"restitution": {"e0": E0}}, tones_of(plate), g_mps2=G, period_s=PERIOD_S, flights=60, unseen_s=1e-4
    )
    n, missed = len(orbit.landing_s), []
    for first in range(4, n - 2):
        flights = table(orbit.landing_s, orbit.takeoff_s, ~orbit.after_rest, np.arange(n) >= first)
        p = one_ahead(flights, plate, row({"restitution": {"e0": E0}}, G), Detection(weak_mps=np.inf))
        missed.append(np.abs(p.landing_s - orbit.landing_s)[first : first + 2])
    assert np.mean(np.array(missed) < 1e-6) > 0.95  # the others follow a chatter too small to be in the table


@pytest.mark.parametrize("dated", [0, 1, 2, 4, "end"])
def test_a_chatter_is_met_at_the_bounce_that_was_seen(dated: int | str) -> None:
    """On a plate at rest bounces are a geometric series: the flight ends at the one seen, or where the series does."""
    speed = 0.12
    durations = 2.0 * speed / G * E0 ** np.arange(1, 60)
    bounces = np.cumsum(durations)
    end = bounces[-1] if dated == "end" else bounces[int(dated)]
    flights = table(
        np.array([0.0, end + 3e-6]), np.array([-2.0 * speed / G, 0.0]), np.array([False, True]), np.array([False, True])
    )
    p = one_ahead(flights, moving(0.0), row({"restitution": {"e0": E0}}, G), Detection(weak_mps=np.inf))
    nearest = RESOLVED_S if dated == "end" else 1e-7  # impacts closer together than the circuit resolves are one
    assert p.landing_s[1] == pytest.approx(end, abs=nearest)


@pytest.mark.parametrize("closure_s", [0.0, 1e-4])
def test_bounces_too_close_to_be_told_apart_are_no_free_choice(closure_s: float) -> None:
    """A chatter of 40 us ends a flight where contacts that short are not seen, and begins it where they are, always."""
    speed, e = 5.0, 0.006
    first = 2.0 * speed * e / G
    chatter = first * e / (1.0 - e)
    assert 3e-5 < chatter < RESOLVED_S
    wanted = first + (chatter if closure_s == 0.0 else 0.0)
    for seen in (first, first + 0.5 * chatter, first + chatter):  # whatever was measured
        flights = table(
            np.array([0.0, seen]), np.array([-2.0 * speed / G, 0.0]), np.array([False, True]), np.array([False, True])
        )
        p = one_ahead(
            flights, moving(0.0), row({"restitution": {"e0": e}}, G), Detection(weak_mps=np.inf, closure_s=closure_s)
        )
        assert p.landing_s[1] == pytest.approx(wanted, abs=1e-6)
        assert p.ambiguity_s[1] == pytest.approx(0.2 * (wanted - first), abs=1e-6)


def test_an_impact_that_must_have_been_heard_ends_the_flight() -> None:
    """Where the accelerometer hears the first impact, a later landing is a miss, not another bounce."""
    speed = 0.3
    bounces = np.cumsum(2.0 * speed / G * E0 ** np.arange(1, 4))
    flights = table(
        np.array([0.0, bounces[1]]), np.array([-2.0 * speed / G, 0.0]), np.array([False, True]), np.array([False, True])
    )
    p = one_ahead(flights, moving(0.0), row({"restitution": {"e0": E0}}, G), Detection(weak_mps=0.03))
    assert p.landing_s[1] == pytest.approx(bounces[0], abs=1e-9)


def test_grazes_alone_are_missed_by_far(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Elastic runs of nothing but noise: what is missed by far was near grazing, the rest by the floor."""
    ratios, far, left = [], 0, []
    for seed in range(3):
        model = fly_ramp(REBOUNDS, seed, gammas=tuple(np.linspace(0.5, 2.4, 14)))
        rows, out = scored_rows(model, REBOUNDS, np.ones(len(model.observations.steps), dtype=bool))
        ratios.append(
            held_out_errors(model, REBOUNDS, rows, out).landing_rms_us / noise_floors_us(model, REBOUNDS, rows)[0]
        )
        left.append(out)
        missed = np.abs(model.residuals(REBOUNDS).landing_s) > 1e-3
        far += int(missed.sum())
        assert not np.any(missed[rows])
    assert far > 0
    assert max(left) < 0.1
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)


def test_whether_a_flight_is_fragile_does_not_hang_on_its_own_landing(fly_ramp: Callable[..., ForwardModel]) -> None:
    """The last flight of each step, moved by a tenth of a millisecond, is as near_grazing as before."""
    model = fly_ramp(REBOUNDS, 0)
    ev = model.observations
    last = np.append(ev.measured.step[1:] != ev.measured.step[:-1], True)
    landing = ev.measured.landing_s + 1e-4 * last
    moved = ForwardModel(replace(ev, measured=replace(ev.measured, landing_s=landing)), {})
    assert np.array_equal(near_grazing(model, REBOUNDS)[last], near_grazing(moved, REBOUNDS)[last])


def test_an_impact_passed_over_keeps_the_circuit_closed() -> None:
    """A bounce too small to be seen delays the opening of the flight after it by no more than the contact's closure."""
    plate, closure_s = moving(1.9), 2e-2
    effects = {"restitution": {"e0": 0.2}}
    orbit = simulate(effects, tones_of(plate), g_mps2=G, period_s=PERIOD_S, flights=60, unseen_s=2e-3)
    flights = table(orbit.landing_s, orbit.takeoff_s, ~orbit.after_rest, np.arange(len(orbit.landing_s)) > 1)
    sharp, late = (one_ahead(flights, plate, row(effects, G), Detection(closure_s=s)) for s in (0.0, closure_s))
    delay = (late.opening_s - sharp.opening_s)[2:]
    passed = sharp.hidden[2:] > 0
    assert np.array_equal(late.landing_s, sharp.landing_s, equal_nan=True)
    assert np.all(delay[~passed] == 0.0)
    assert 0.0 < delay[passed].max() <= closure_s


@pytest.mark.parametrize("seen", ["first", "second"])
@pytest.mark.parametrize("closure_s", [0.0, 1e-4])
def test_a_strong_impact_between_two_samples_is_passed_where_its_rebound_is_short(seen: str, closure_s: float) -> None:
    """A ball of restitution 0.02 is back within 0.2 ms: where contacts last no time, either landing may be seen.

    Where an impact keeps the circuit closed for a while, it is the first.
    """
    plate, effects = moving(1.25), {"restitution": {"e0": 0.02}}
    orbit = simulate(effects, tones_of(plate), g_mps2=G, period_s=PERIOD_S, flights=60, unseen_s=1e-6)
    far = np.flatnonzero(orbit.landing_s - orbit.takeoff_s > 5e-3)[2:-1]
    first, second = orbit.landing_s[far], orbit.landing_s[far + 1]
    assert np.all((second - first > RESOLVED_S) & (second - first < 2e-4))
    landing, none = first if seen == "first" else second, np.zeros(len(far), bool)
    flights = table(landing, orbit.takeoff_s[far], none, np.arange(len(far)) > 0)
    detection = Detection(unseen_s=2e-4, weak_mps=0.03, closure_s=closure_s)
    p = one_ahead(flights, plate, row(effects, G), detection)
    expected = landing if closure_s == 0.0 else first
    assert np.abs(p.landing_s - expected)[1:] == pytest.approx(0.0, abs=3e-6)  # the chatter after it lasts 2.6 us


def test_the_impact_that_ends_a_flight_rebounds_as_the_next_one_begins() -> None:
    """Where restitution differs from flight to flight, that of the next one says whether an impact may be passed."""
    plate, speed = moving(0.0), np.array([2.0, 0.04, 0.02])  # of restitution 0.02, then of 0.5
    landing = np.cumsum(2.0 * speed / G)
    opening = landing - 2.0 * speed / G
    rows = np.stack([row({"restitution": {"e0": e}}, G) for e in (0.0, 0.02, 0.5)])
    seen = landing + np.array([0.0, 1e-4, 0.0])  # nearer to where a second bounce of 0.02 would end
    flights = table(seen, opening, np.ones(3, bool), np.array([False, True, True]))
    p = one_ahead(flights, plate, rows, Detection(unseen_s=2e-4, weak_mps=0.01))
    assert p.landing_s[1] == pytest.approx(landing[1], abs=1e-9)
