"""How sharp the accelerometer's times of impacts are, compared with the contact circuit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.events.edges import Edges
from analysis.events.impact_detection import Impacts
from analysis.events.levels import CLOSES
from analysis.events.sensor_offset import SensorOffset, calibrate, combine_with_impacts, common_offset, motion_late
from analysis.plate.motion import PlateMotion

SAMPLING_S = 5e-5
ROUNDING_S = SAMPLING_S / np.sqrt(12.0)


def closings(rounded: bool) -> tuple[np.ndarray, np.ndarray, Edges]:
    """Two hundred landings anywhere between samples: true times, and both sensors' in the order impacts, edges."""
    rng = np.random.default_rng(3)
    exact = np.sort(10.0 * rng.random(200))
    edge = SAMPLING_S * (np.floor(exact / SAMPLING_S) + 0.5)
    impact = edge if rounded else exact
    noise = 1e-6 * rng.standard_normal(200)
    return exact, impact + noise, Edges(edge, np.full(200, ROUNDING_S), np.full(200, CLOSES))


@pytest.mark.parametrize("rounded", [False, True])
def test_impacts_at_one_place_between_samples_are_no_sharper_than_samples(rounded: bool) -> None:
    """An accelerometer that shows an impact only by its first sample rounds as the contact circuit does: together
    they know a landing to the rounding, where one that resolves it knows it to a microsecond or two."""
    exact, impact_s, edges = closings(rounded)
    impacts = Impacts(impact_s, np.full(200, 1e-6), np.linspace(5.0, 20.0, 200))
    moved, offset = calibrate(impacts, edges.time_s - 0.02, edges.time_s, edges.uncertainty_s, 0.0, SAMPLING_S)
    both = combine_with_impacts(edges, moved, offset)
    error = both.time_s - exact
    assert np.std(error) == pytest.approx(ROUNDING_S if rounded else 1e-6, rel=0.15)
    assert np.all(both.uncertainty_s > 0.9 * ROUNDING_S) if rounded else np.all(both.uncertainty_s < 5e-6)


def test_a_converters_delay_of_many_samples_is_found() -> None:
    """An accelerometer 1.9 ms behind the contact circuit, as a sigma-delta converter's filter makes it."""
    exact, impact_s, edges = closings(False)
    impacts = Impacts(impact_s + 1.9e-3, np.full(200, 1e-6), np.linspace(5.0, 20.0, 200))
    moved, offset = calibrate(impacts, edges.time_s - 0.02, edges.time_s, edges.uncertainty_s, 0.0, SAMPLING_S)
    assert offset.offset_s == pytest.approx(1.9e-3, abs=5e-6)
    assert np.abs(moved.time_s - exact).max() < 1e-5


def test_a_few_chatters_of_one_length_are_no_offset_of_the_sensors() -> None:
    """Closings at the end of chatters of .4 to 1.6 ms, of which one in eight has a single impact, all of one length."""
    rng = np.random.default_rng(4)
    first_s = 0.05 * np.arange(1, 401) + 1e-3 * rng.random(400)
    alike = np.arange(400) % 8 == 0
    lasts_s = np.where(alike, 6.2e-4 + 5e-6 * rng.standard_normal(400), rng.uniform(4e-4, 1.6e-3, 400))
    second_s = first_s[~alike] + 0.6 * lasts_s[~alike]
    order = np.argsort(impact_s := np.concatenate([first_s, second_s]))
    impacts = Impacts(impact_s[order], np.full(order.size, 1e-6), rng.uniform(5.0, 20.0, order.size))
    closed_s = first_s + lasts_s
    moved, offset = calibrate(impacts, first_s - 0.02, closed_s, np.full(400, 5e-6), 0.0, SAMPLING_S)
    assert np.isinf(offset.uncertainty_s)
    assert moved.time_s == pytest.approx(impact_s[order])


def test_the_impact_is_the_landing_where_a_chattering_contact_closes_later() -> None:
    """One closing in five comes .1 ms after the impact: all landings are the impacts, none behind an edge before it."""
    exact, impact_s, edges = closings(False)
    late = np.arange(200) % 5 == 0
    edges = Edges(exact + np.where(late, 1e-4, 2e-6), np.full(200, 4e-6), edges.kind)
    impacts = Impacts(impact_s, np.full(200, 1e-6), np.linspace(5.0, 20.0, 200))
    moved, offset = calibrate(impacts, edges.time_s - 0.02, edges.time_s, edges.uncertainty_s, 0.0, SAMPLING_S)
    assert np.abs(combine_with_impacts(edges, moved, offset).time_s - exact).max() < 1e-5


def test_a_contact_that_jitters_is_not_believed_where_it_errs_most() -> None:
    """Edges that jitter by 25 us beyond their rounding: every landing is close to the impact, those 80 us off, too."""
    exact, impact_s, edges = closings(False)
    jitter = 2.5e-5 * np.random.default_rng(6).standard_normal(200)
    assert np.abs(jitter).max() > 6e-5
    edges = Edges(np.sort(edges.time_s + jitter), edges.uncertainty_s, edges.kind)
    impacts = Impacts(impact_s, np.full(200, 1e-6), np.linspace(5.0, 20.0, 200))
    moved, offset = calibrate(impacts, edges.time_s - 0.02, edges.time_s, edges.uncertainty_s, 0.0, SAMPLING_S)
    error = combine_with_impacts(edges, moved, offset).time_s - exact
    assert offset.spread_s == pytest.approx(2.9e-5, rel=0.3)
    assert np.abs(error - np.median(error)).max() < 2.5e-5


@pytest.mark.parametrize("motion_s", [0.0, 4e-5])
def test_jitter_that_repeated_cycles_show_is_the_contacts_and_not_the_impacts(motion_s: float) -> None:
    """Soft impacts in noise beside loud ones, edges that jitter by 25 us: landings are the impacts, as sure as stated.
    What the ball itself scatters from cycle to cycle, the two sensors do not differ by."""
    rng = np.random.default_rng(7)
    exact, _, edges = closings(False)
    own = np.where(np.arange(200) % 2 == 0, 1e-6, 8e-6)
    edges = Edges(np.sort(edges.time_s + 2.5e-5 * rng.standard_normal(200)), edges.uncertainty_s, edges.kind)
    impacts = Impacts(exact + own * rng.standard_normal(200), own, np.linspace(5.0, 20.0, 200))
    seen = impacts, edges.time_s - 0.02, edges.time_s, edges.uncertainty_s, 0.0, SAMPLING_S
    moved, offset = calibrate(*seen, repeated_s=float(np.hypot(2.5e-5, motion_s)))
    assert offset.jitter_s == pytest.approx(2.5e-5, rel=0.3)
    assert offset.motion_s == pytest.approx(motion_s, abs=2e-5)
    landings = combine_with_impacts(edges, moved, offset)
    error = landings.time_s - exact - np.median(landings.time_s - exact)
    assert np.std(error[own < 2e-6]) < 3e-6 and np.std(error[own > 2e-6]) < 1e-5
    assert 0.6 < np.std(error / landings.uncertainty_s) < 1.2


@pytest.mark.parametrize("jitter_s", [0.0, 2e-5])
def test_where_no_landing_repeats_all_that_the_sensors_differ_by_may_be_the_contacts(jitter_s: float) -> None:
    """Over a ringing plate no cycle is like the next: the contact's jitter shows all the same, in each of 20 recordings
    of 120 landings, and none where there is none."""
    found = []
    for seed in range(20):
        rng = np.random.default_rng([9, seed])
        exact = np.sort(10.0 * rng.random(120))
        edge = SAMPLING_S * (np.floor((exact + jitter_s * rng.standard_normal(120)) / SAMPLING_S) + 0.5)
        impacts = Impacts(exact + 1e-6 * rng.standard_normal(120), np.full(120, 1e-6), rng.uniform(5.0, 20.0, 120))
        seen = impacts, np.sort(edge) - 0.02, np.sort(edge), np.full(120, ROUNDING_S), 0.0, SAMPLING_S
        found.append(calibrate(*seen, repeated_s=np.inf)[1].jitter_s)
    assert found == pytest.approx([jitter_s] * 20, abs=0.35 * jitter_s)


def test_rebounds_too_soft_to_be_heard_do_not_hide_the_offset() -> None:
    """A contact that jitters by 20 us, and after most landings a rebound of .7 ms whose own landing is not heard."""
    rng = np.random.default_rng(8)
    exact, impact_s, edges = closings(False)
    landing = np.sort(edges.time_s + 2e-5 * rng.standard_normal(200))
    again = landing[rng.random(200) < 0.7]
    takeoff_s, landing_s = np.concatenate([landing - 0.02, again + 1e-4]), np.concatenate([landing, again + 7e-4])
    order = np.argsort(landing_s)
    impacts = Impacts(impact_s + 1e-4, np.full(200, 1e-6), np.linspace(5.0, 20.0, 200))
    sigma = np.full(len(order), ROUNDING_S)
    moved, _ = calibrate(impacts, takeoff_s[order], landing_s[order], sigma, 0.0, SAMPLING_S)
    assert np.abs(moved.time_s - exact).max() < 1e-5


def test_a_recording_whose_contact_never_closes_takes_the_offset_that_others_of_the_rig_show() -> None:
    """Three recordings of one step each show it, a fourth, in which no landing closes the contact, is corrected by it;
    three that differ by 6 us say no more than that."""
    exact, impact_s, edges = closings(False)
    impacts = Impacts(impact_s + 4e-4, np.full(200, 1e-6), np.linspace(5.0, 20.0, 200))
    rest = edges.uncertainty_s, 0.0, SAMPLING_S
    shown = calibrate(impacts, edges.time_s - 0.02, edges.time_s, *rest)[1]
    others = [replace(shown, offset_s=shown.offset_s + more_s) for more_s in (-6e-6, 0.0, 6e-6)]
    silent = SensorOffset(0.0, np.inf, 0)
    common = common_offset([*others, silent])
    assert common is not None
    assert common_offset([silent]) is None
    nothing = np.zeros(0)
    moved, own = calibrate(impacts, nothing, nothing, nothing, 0.0, SAMPLING_S, common)
    assert np.abs(moved.time_s - exact).max() < 1e-5
    assert 6e-6 < own.uncertainty_s < 1.2e-5
    assert np.all(moved.uncertainty_s > 6e-6)


def test_edges_may_be_uneven_where_closings_jitter_or_come_late() -> None:
    """Chatter, hysteresis, a comparator without impacts to compare: not an even circuit, nor a late accelerometer."""
    even, late = SensorOffset(2e-6, 1e-6, 100), SensorOffset(5e-5, 1e-6, 100)
    chatter, hysteresis = replace(late, jitter_s=8e-6), SensorOffset(-3.7e-5, 1e-6, 100)
    assert not any(x.uneven_edges(sharp) for x in (even, late) for sharp in (False, True))
    assert all(x.uneven_edges(sharp) for x in (chatter, hysteresis) for sharp in (False, True))
    assert not replace(hysteresis, rounding_s=1.4e-5).uneven_edges(sharp=True)
    unknown = SensorOffset(0.0, np.inf, 0)
    assert unknown.uneven_edges(sharp=True)
    assert not unknown.uneven_edges(sharp=False)


def test_closings_at_few_places_between_samples_may_all_be_late_where_openings_are_not() -> None:
    """Twelve steps of twenty landings, each step at one place: together they err by more than they seem to."""
    rng = np.random.default_rng(6)
    exact = (np.arange(12)[:, None] + rng.uniform(0.0, SAMPLING_S, (12, 1)) + 0.04 * np.arange(1, 21)).ravel()
    edge = SAMPLING_S * (np.floor(exact / SAMPLING_S) + 0.5)
    impacts = Impacts(exact + 1e-6 * rng.standard_normal(240), np.full(240, 1e-6), np.linspace(5.0, 20.0, 240))
    rounding_s = np.full(240, ROUNDING_S)
    _, offset = calibrate(impacts, edge - 0.02, edge, rounding_s, 0.0, SAMPLING_S)
    assert abs(offset.offset_s) < 3.0 * offset.repeated_s
    assert offset.repeated_s == pytest.approx(ROUNDING_S / np.sqrt(12.0), rel=0.5)
    assert all(offset.uneven_edges(sharp) for sharp in (False, True))
    anywhere, impact_s, edges = closings(False)
    impacts = Impacts(impact_s, np.full(200, 1e-6), np.linspace(5.0, 20.0, 200))
    _, offset = calibrate(impacts, anywhere - 0.02, edges.time_s, edges.uncertainty_s, 0.0, SAMPLING_S)
    assert not offset.uneven_edges(sharp=False)


def takeoffs(late_s: float, gammas: list[float], rng: np.random.Generator) -> tuple[PlateMotion, list[np.ndarray]]:
    """A plate that is shown late, and take-offs from it, landings and steps of a ball that friction of .1 g holds."""
    omega, g, tones, times, steps = 2.0 * np.pi * 25.0, 9.80665, [], [], []
    for k, gamma in enumerate(gammas):
        # the plate's acceleration is gamma g sin(omega t): the ball leaves at -1.1 g
        at = (np.pi + np.arcsin(1.1 / gamma)) / omega + 0.04 * np.arange(10) + k
        times.append(at + 2e-6 * rng.standard_normal(10))
        steps.append(np.full(10, k))
        tones.append(-1j * gamma * g * np.exp(-1j * omega * late_s))
    plate = object.__new__(PlateMotion)
    forcing = np.full((1, len(tones)), omega), np.array([tones])
    plate.__dict__.update(_forcing=forcing, gaps=np.zeros((0, 2), np.int64), rate_hz=2e4, steps=(None,) * len(tones))
    takeoff = np.concatenate(times)
    return plate, [takeoff, takeoff + 0.02, np.concatenate(steps)]


def test_takeoffs_tell_by_how_much_motion_is_shown_late() -> None:
    """1.6 ms of a converter's filter, with a friction that nobody knows; one amplitude does not tell it."""
    plate, flights = takeoffs(1.6e-3, [1.2, 1.5, 1.8, 2.2], np.random.default_rng(5))
    assert motion_late(plate, *flights) == pytest.approx(1.6e-3, abs=3e-5)
    plate, flights = takeoffs(1.6e-3, [1.5, 1.5, 1.5, 1.5], np.random.default_rng(5))
    assert np.isnan(motion_late(plate, *flights))


def test_impacts_are_late_as_motion_is_where_no_closing_has_one() -> None:
    """A ball that bounces closes the circuit after impacts too weak to be heard: what motion shows is taken."""
    rng = np.random.default_rng(6)
    closed_s = 0.05 * np.arange(1, 101) + 1e-3 * rng.random(100)
    impacts = Impacts(closed_s - rng.uniform(1e-3, 4e-3, 100) + 1.6e-3, np.full(100, 1e-6), np.full(100, 9.0))
    rest = closed_s - 0.02, closed_s, np.full(100, 5e-6), 0.0, SAMPLING_S
    moved, offset = calibrate(impacts, *rest, motion_late_s=1.6e-3)
    assert offset == SensorOffset(1.6e-3, np.inf, 0)
    np.testing.assert_allclose(moved.time_s, impacts.time_s - 1.6e-3)
