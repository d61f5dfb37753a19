"""Fits: intervals that hold the truth, calibrations that hold their place, slopes that save predictions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from analysis.attribution.candidates import Prior, coordinate_of, priors_of, scale_of
from analysis.attribution.fit import CURVATURE, Fitter, damped_step
from analysis.residuals.forward_model import ForwardModel, Residuals
from analysis.residuals.noise.noise_model import FREEDOM, robust_weight
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import ParameterId
from analysis.thresholds import CALIBRATION_SIGMAS
from kernels.arrays import Bools

UP, DOWN, RATE = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down"), ("viscous_damping", "rate_per_s")
TRUTH = {UP: 0.12, DOWN: 0.18}


def test_intervals_hold_the_truth_as_often_as_they_say(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Sixteen runs, both frictions, begun a good way off and fitted again from there, as an explanation is.

    The sum of squared pulls is a chi-square's, on either side. The accelerometer's scale is as wrong as its prior
    says; it and friction trade places.
    """
    pulls, scale = [], ("accelerometer_gain", "relative")
    for seed in range(16):
        off = 0.005 * np.random.default_rng(100 + seed).standard_normal()
        model = fly_ramp({**TRUTH, scale: off}, seed, gammas=(0.5, 0.9, 0.7, 1.2))
        fitter = Fitter(model, priors_of(model.observations.setup), np.ones(4, dtype=bool))
        whitener = Whitener.of(model, {**TRUTH, scale: off})
        fitted = fitter.fit(whitener, (UP, DOWN), fitter.fit(whitener, (UP, DOWN), {UP: 0.15, DOWN: 0.15}).values)
        pulls += [(fitted.values[k] - TRUTH[k]) / fitted.sigma(k) for k in TRUTH]
    low, high = stats.chi2.ppf((0.002, 0.998), len(pulls))
    assert low < np.sum(np.square(pulls)) < high
    assert abs(np.mean(pulls)) < 3.5 / np.sqrt(len(pulls))


@pytest.mark.parametrize(("noise", "wide"), [(stats.t(FREEDOM), 1.0), (stats.norm(), 1.1)])
def test_a_robust_mean_scatters_as_the_curvature_of_its_loss_says(noise: Any, wide: float) -> None:
    """Means of 100 by the loss: of Student's errors as stated, of normal ones 10 % less; by weights alone 15 % more."""
    draws = noise.rvs(size=(4000, 100), random_state=7)
    mean = np.zeros((4000, 1))
    for _ in range(30):
        weight = robust_weight(draws - mean)
        mean = np.sum(weight * draws, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
    stated = 1.0 / np.sqrt(CURVATURE * np.sum(weight, axis=1))
    assert np.mean(stated) == pytest.approx(wide * np.std(mean), rel=0.04)


@pytest.mark.parametrize("late_s", [1.2e-5, -8.4e-5])
def test_closings_of_another_delay_than_openings_bend_neither_lag_nor_friction(
    fly_ramp: Callable[..., ForwardModel], late_s: float
) -> None:
    """A contact that chatters closes late, one behind a comparator with hysteresis opens late: both are measured."""
    lag, late = ("accelerometer_lag", "delay_s"), ("contact_closure", "late_s")
    truth = {**TRUTH, lag: 1e-4, late: late_s}
    made = fly_ramp({**TRUTH, lag: 1e-4}, 2).observations
    landing_s, opening_s = made.measured.landing_s + late_s, made.measured.opening_s + late_s * made.measured.relaunched
    measured = replace(made.measured, landing_s=landing_s, opening_s=opening_s)
    model = ForwardModel(replace(made, measured=measured, circuit=replace(made.circuit, uneven=True)), {})
    fitter = Fitter(model, priors_of(model.observations.setup), np.ones(len(model.observations.steps), dtype=bool))
    fitted = fitter.fit(Whitener.of(model, truth), (lag, UP, DOWN), {**TRUTH, lag: 5e-5})
    for key, value in truth.items():
        assert fitted.values[key] == pytest.approx(value, abs=3.5 * fitted.sigma(key))
    assert fitted.sigma(late) < 5e-6


def test_a_calibration_goes_no_farther_than_its_uncertainty_lets_it(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Gravity 3 % off where 0.1 % is claimed: it stays within bounds, and the loss says that something is wrong."""
    gravity = ("local_gravity", "excess_mps2")
    model = fly_ramp({gravity: 0.3}, 0)
    fitter = Fitter(model, {gravity: Prior(0.0, 0.01)}, np.ones(len(model.observations.steps), dtype=bool))
    whitener = Whitener.of(model, {gravity: 0.3})
    bound, free = fitter.fit(whitener, (), {}), fitter.fit(whitener, (gravity,), {})
    assert bound.values[gravity] == pytest.approx(CALIBRATION_SIGMAS * 0.01, rel=1e-6)
    assert bound.moved_calibrations(0.99 * CALIBRATION_SIGMAS) == {gravity}
    assert free.values[gravity] == pytest.approx(0.3, abs=4 * free.sigma(gravity))
    assert bound.loss > free.loss + 100.0


def test_a_fit_sees_its_training_steps_only(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Flights of the other steps may be anything: the values stay, their held-out loss does not."""
    model = fly_ramp(TRUTH, 1)
    m = len(model.observations.steps)
    train = np.arange(m) % 4 != 2
    whitener = Whitener.of(model, TRUTH)
    fitted = Fitter(model, {}, train).fit(whitener, (UP, DOWN), TRUTH)
    spoilt = {UP: 0.0, DOWN: 0.0}
    other = ~train[model.observations.measured.step]
    landing = model.observations.measured.landing_s + np.where(other, 1e-3, 0.0)
    shifted = ForwardModel(
        replace(model.observations, measured=replace(model.observations.measured, landing_s=landing)), {}
    )
    again = Fitter(shifted, {}, train).fit(whitener, (UP, DOWN), TRUTH)
    assert again.values == pytest.approx(fitted.values, rel=1e-6)
    assert spoilt.keys() == fitted.values.keys()


def test_what_was_identified_stays_where_a_fit_would_hardly_move_it(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Begun at its best value it has the same one after a fit of the rest, as good as any; begun far off it moves."""
    model = fly_ramp(TRUTH, 1)
    fitter = Fitter(model, {}, np.ones(len(model.observations.steps), dtype=bool))
    fitter.identified = {UP: Prior(TRUTH[UP], 1e-5)}
    whitener, free = Whitener.of(model, TRUTH), (UP, DOWN)
    best = fitter.fit(whitener, free, {**TRUTH, DOWN: 0.178})
    near = fitter.fit(whitener, free, {**best.values, DOWN: best.values[DOWN] - 1e-3})
    assert near.values[UP] == best.values[UP]
    far = fitter.fit(whitener, free, {UP: 0.15, DOWN: 0.15})
    assert far.values[UP] == pytest.approx(best.values[UP], abs=0.1 * best.sigma(UP))
    assert max(near.loss, far.loss) < best.loss + 0.05


def test_a_promise_is_kept_where_residuals_are_linear(fly_ramp: Callable[..., ForwardModel]) -> None:
    """The gain that `linear_step` foretells for a weak damping is what the fit then finds, within a third."""
    model = fly_ramp({RATE: 0.05}, 2)
    fitter = Fitter(model, {}, np.ones(len(model.observations.steps), dtype=bool))
    whitener = Whitener.of(model, {RATE: 0.05})
    nothing, something = fitter.fit(whitener, (), {}), fitter.fit(whitener, (RATE,), {})
    promised, point = fitter.linear_step(nothing, (RATE,))
    assert promised == pytest.approx(nothing.loss - something.loss, rel=0.33)
    assert point[RATE] == pytest.approx(something.values[RATE], rel=0.33)


def test_a_promise_leaves_out_what_the_fit_itself_would_still_gain(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A fit that stopped 20 % short of its damping promises nothing by friction, of which there is none."""
    model = fly_ramp({RATE: 1.0}, 2)
    fitter = Fitter(model, {}, np.ones(len(model.observations.steps), dtype=bool))
    fitted = fitter.fit(Whitener.of(model, {RATE: 1.0}), (RATE,), {RATE: 1.0})
    x = 0.8 * fitted.x
    short = replace(fitted, x=x, raw=fitted.state.raw(x))
    assert fitted.state.loss(short.raw, x) - fitted.loss > 20.0
    assert fitter.linear_step(short, ())[0] == 0.0
    assert abs(fitter.linear_step(short, (UP, DOWN))[0]) < 4.0


def test_a_size_differs_from_nothing_only_beyond_its_interval(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Friction of 0.12 differs from none, a damping that is not there does not, and a shape never counts."""
    model = fly_ramp(TRUTH, 3)
    fitter = Fitter(model, {}, np.ones(len(model.observations.steps), dtype=bool))
    fitted = fitter.fit(Whitener.of(model, TRUTH), (UP, DOWN, RATE), TRUTH)
    assert fitted.differs((UP, DOWN)) and fitted.differs((UP, RATE))
    assert not fitted.differs((RATE,))


def test_what_a_calibration_could_make_up_for_beyond_its_bound_differs_from_nothing(
    fly_ramp: Callable[..., ForwardModel],
) -> None:
    """A lag of 5 us is 1.6 standard deviations, as a height of the circuit below zero would hide it; there is none.

    Without the lag the loss is higher by more than half of 3.84, the 95 % of a chi-square.
    """
    lag = ("accelerometer_lag", "delay_s")
    made = fly_ramp({lag: 5e-6}, 2).observations
    model = ForwardModel(replace(made, circuit=replace(made.circuit, uneven=True)), {})
    fitter = Fitter(model, priors_of(model.observations.setup), np.ones(len(model.observations.steps), dtype=bool))
    fitted = fitter.fit(Whitener.of(model, {lag: 5e-6}), (lag,), {lag: 5e-6})
    assert fitted.values[lag] < 1.96 * fitted.sigma(lag)
    assert fitter.fit(fitted.state.whitener, (), {}).loss - fitted.loss > 0.5 * 3.84
    assert fitted.differs((lag,))


def test_a_search_survives_a_singular_matrix(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Gravity, drive and accelerometer wrong by one factor are one: the fit of all three ends, with finite values."""
    model = fly_ramp({RATE: 0.5}, 2, gammas=(0.5, 0.9, 0.7))
    keys = (("local_gravity", "excess_mps2"), ("drive_gain", "relative"), ("accelerometer_gain", "relative"), RATE)
    fitter = Fitter(model, {}, np.ones(3, dtype=bool))
    fitted = fitter.fit(Whitener.of(model, {RATE: 0.5}), keys, {})
    assert np.isfinite(fitted.x).all() and np.isfinite(fitted.loss)
    assert fitted.values[RATE] == pytest.approx(0.5, abs=0.2)
    step = damped_step(np.ones((3, 3)), np.ones(3), 0.0, np.full(3, -5.0), np.full(3, 5.0))
    assert np.sum(step) == pytest.approx(1.0)
    assert damped_step(np.zeros((2, 2)), np.zeros(2), 0.0, np.full(2, -5.0), np.full(2, 5.0)) == pytest.approx(
        [0.0, 0.0]
    )


def test_a_point_without_a_number_has_no_slope(
    fly_ramp: Callable[..., ForwardModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plate datum that is no number a step away, as where a mode is the whole tone: the fit goes on without it."""
    model = fly_ramp({RATE: 0.5}, 2, gammas=(0.5, 0.9, 0.7))
    exact, whitener, calls = model.residuals, Whitener.of(model, {RATE: 0.5}), itertools.count()

    def broken(values: Mapping[ParameterId, float], wanted: Bools | None = None) -> Residuals:
        found = exact(values, wanted=wanted)
        lost = next(calls) == 1  # the first point a step away from the start
        return replace(found, plate=np.where(lost & (np.arange(len(found.plate)) == 0), np.nan, found.plate))

    monkeypatch.setattr(model, "residuals", broken)
    fitted = Fitter(model, {}, np.ones(3, dtype=bool)).fit(whitener, (RATE,), {RATE: 0.3})
    assert fitted.values[RATE] == pytest.approx(0.5, abs=0.1)


def test_a_flight_that_leaps_does_not_hold_a_parameter(
    fly_ramp: Callable[..., ForwardModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One landing leaps by .3 ms with any damping above that of the start: the fit leaves it as if it did not."""
    model = fly_ramp({RATE: 0.5}, 2, gammas=(0.5, 0.9, 0.7))
    exact, whitener = model.residuals, Whitener.of(model, {RATE: 0.5})
    row = int(np.flatnonzero(model.observations.scored)[5])
    fitter = Fitter(model, {}, np.ones(3, dtype=bool))
    smooth = fitter.fit(whitener, (RATE,), {RATE: 0.3})

    def leaping(values: Mapping[ParameterId, float], wanted: Bools | None = None) -> Residuals:
        found = exact(values, wanted=wanted)
        beyond = (values[RATE] > 0.3) & (np.arange(len(found.landing_s)) == row)
        return replace(found, landing_s=found.landing_s + 3e-4 * beyond)

    monkeypatch.setattr(model, "residuals", leaping)
    fitted = fitter.fit(whitener, (RATE,), {RATE: 0.3})
    assert fitted.values[RATE] == pytest.approx(smooth.values[RATE], abs=3 * smooth.sigma(RATE))
    x = np.array([coordinate_of(RATE, 0.3)])
    at_start = replace(fitted, x=x, raw=fitted.state.raw(x))
    made, recalled = (fitter.slope(at_start, RATE) for _ in range(2))
    assert made[row] == recalled[row] == 0.0 and np.count_nonzero(made) > 50


def test_an_interval_is_as_wide_as_steps_differ(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A friction that scatters by .001 from step to step, twelve runs: the sum of squared pulls is a chi square's."""
    gammas, friction, pulls = (0.5, 0.9, 0.7, 1.2, 0.6, 1.0, 0.8, 1.1), {UP: 0.15, DOWN: 0.15}, []
    model = fly_ramp(friction, 3, gammas=gammas)
    whitener = Whitener.of(model, friction)
    row, calm = model.observations.measured.step, model.residuals(friction).landing_s
    slope = 100.0 * (model.residuals({UP: 0.16, DOWN: 0.15}).landing_s - calm)
    slope = np.where(np.abs(slope) < 0.05, slope, 0.0)
    for seed in range(12):
        off = 0.001 * np.random.default_rng(seed).standard_normal(len(gammas))
        measured = model.observations.measured
        moved = replace(measured, landing_s=measured.landing_s + np.nan_to_num(slope) * off[row])
        other = ForwardModel(replace(model.observations, measured=moved), {})
        fitter = Fitter(other, {DOWN: Prior(0.15, 1e-6)}, np.ones(len(gammas), dtype=bool))
        fitted = fitter.fit(whitener, (UP,), friction)
        pulls.append((fitted.values[UP] - 0.15) / fitted.sigma(UP))
        stated = np.sqrt(np.diag(fitted.covariance())[0]) * scale_of(UP)
        assert fitted.sigma(UP) > 1.8 * stated
    low, high = stats.chi2.ppf((0.002, 0.998), len(pulls))
    assert low < np.sum(np.square(pulls)) < high
