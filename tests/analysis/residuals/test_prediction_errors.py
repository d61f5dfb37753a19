"""Errors of held-out steps and their floor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.prediction_errors import (
    _tones_given,
    given_openings,
    held_out_errors,
    noise_floors_us,
    noise_quantiles_us,
    scored_rows,
)

FRICTION = {("coulomb_friction", "mu_up"): 0.15, ("coulomb_friction", "mu_down"): 0.15}


def test_the_floor_is_what_a_true_model_misses_by(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Five runs of nothing but noise: rms over floor, of landings and of take-offs, is one within 10 %."""
    landing, opening = [], []
    for seed in range(5):
        model = fly_ramp(FRICTION, seed)
        rows, out = scored_rows(model, FRICTION, np.ones(len(model.observations.steps), dtype=bool))
        errors, floors = held_out_errors(model, FRICTION, rows, out), noise_floors_us(model, FRICTION, rows)
        landing.append(errors.landing_rms_us / floors[0])
        opening.append(errors.takeoff_rms_us / floors[1])
        assert errors.landing_rms_us_low < errors.landing_rms_us < errors.landing_rms_us_high
        own = uncertainty_at(model, FRICTION).landing_sigma_s[rows]
        assert floors[0] > 1e6 * np.sqrt(np.mean(own**2))  # the plate's tones add to the edges
    assert np.mean(landing) == pytest.approx(1.0, abs=0.1)
    assert np.mean(opening) == pytest.approx(1.0, abs=0.1)


def test_only_named_steps_count_and_only_grazes_are_left_out(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Flights of other steps never; of these all but the ones whose landing could not be predicted."""
    model = fly_ramp(FRICTION, 0)
    steps = np.arange(len(model.observations.steps)) == 4
    rows, out = scored_rows(model, FRICTION, steps)
    assert set(model.observations.measured.step[rows]) == {4}
    sigma = np.array(model.observations.landing_sigma_s)
    sigma[rows[:3]] = 1.0  # a landing that is not known to a second
    vague = ForwardModel(replace(model.observations, landing_sigma_s=sigma), {})
    fewer, left = scored_rows(vague, FRICTION, steps)
    assert set(rows[:3]).isdisjoint(fewer)
    assert left == pytest.approx(1.0 - len(fewer) / len(rows))
    assert out <= left
    nothing = held_out_errors(model, FRICTION, rows[:0], 0.0)
    assert nothing.flights == 0
    assert np.isnan(nothing.landing_rms_us)


def test_a_flight_without_prediction_misses_by_half_a_period(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A ball that a wrong model never lets go is no hit."""
    model = fly_ramp({}, 0)
    held = {("adhesion", "a_mps2"): 29.0}
    rows, out = scored_rows(model, held, model.observations.steps.gamma < 0.4)
    assert held_out_errors(model, held, rows, out).landing_rms_us == pytest.approx(0.5e6 / 25.37, rel=0.05)


def test_few_steps_may_miss_by_more_than_their_floor(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Tones err for a whole step: noise exceeds the floor of two steps by more than that of fourteen."""
    model = fly_ramp(FRICTION, 0)
    over = []
    for steps in (2, 14):
        rows, _ = scored_rows(model, FRICTION, np.arange(len(model.observations.steps)) < steps)
        over.append(noise_quantiles_us(model, FRICTION, rows)[0] / noise_floors_us(model, FRICTION, rows)[0])
    assert over[0] > over[1] > 1.0
    assert noise_quantiles_us(model, FRICTION, rows[:0]) == (0.0, 0.0)


def test_openings_tell_the_tones_as_far_as_they_are_sharp() -> None:
    """Twenty openings that two errors shift by 10 us each, known to 1 us, to 1 ms: found again, or left unknown."""
    by_tone, errors = 1e-5 * np.random.default_rng(1).standard_normal((20, 2)), np.array([2.0, -1.5])
    for sigma, known in ((1e-6, True), (1e-3, False)):
        mean, root = _tones_given(by_tone @ errors, np.full(20, sigma), by_tone)
        left = np.sqrt(np.diag(root @ root.T))
        assert np.all(left < 0.1) == known
        assert np.all(left > 0.9) != known
        assert (np.abs(mean - errors) < 0.1).all() == known


def test_openings_narrow_the_floor_of_their_landings(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Tones twenty times as uncertain as they are: given the openings, landings have a lower floor, and keep to it."""
    model = fly_ramp(FRICTION, 0)
    steps = replace(model.observations.steps, spread_mps2=20.0 * model.observations.steps.spread_mps2)
    vague = ForwardModel(replace(model.observations, steps=steps), {})
    rows = np.flatnonzero(vague.observations.scored & vague.from_rest)
    told = given_openings(vague, FRICTION, rows)
    assert told.floor_us < noise_floors_us(vague, FRICTION, rows)[0]
    assert told.landing_rms_us < told.chance_us
    assert np.isnan(given_openings(vague, FRICTION, rows[:0]).landing_rms_us)


def test_openings_excuse_no_landing_of_their_own(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Landings 60 us late with openings in time, as friction would leave them: they stay missed."""
    model = fly_ramp(FRICTION, 0)
    measured = model.observations.measured
    late = replace(measured, landing_s=measured.landing_s + 6e-5)
    rows = np.flatnonzero(model.observations.scored)
    told = given_openings(ForwardModel(replace(model.observations, measured=late), {}), FRICTION, rows)
    assert told.landing_rms_us > 1.5 * max(told.floor_us, told.chance_us)


def test_landings_of_other_events_are_counted_and_told_apart_from_noise(fly_ramp: Callable[..., ForwardModel]) -> None:
    """One landing 5 ms off makes nearly all of the rms: it is lost, and the rest is what it was."""
    model = fly_ramp(FRICTION, 0)
    rows, out = scored_rows(model, FRICTION, np.ones(len(model.observations.steps), dtype=bool))
    clean = held_out_errors(model, FRICTION, rows, out)
    landing = model.observations.measured.landing_s.copy()
    landing[rows[-1]] += 5e-3  # no flight is predicted from the last one
    off = replace(model.observations, measured=replace(model.observations.measured, landing_s=landing))
    errors = held_out_errors(ForwardModel(off, {}), FRICTION, rows, out)
    assert (clean.lost, errors.lost) == (0, 1)
    assert clean.landing_rms_us_without_lost == clean.landing_rms_us
    assert errors.landing_rms_us > 5.0 * clean.landing_rms_us
    assert errors.landing_rms_us_without_lost == pytest.approx(clean.landing_rms_us, rel=0.02)
