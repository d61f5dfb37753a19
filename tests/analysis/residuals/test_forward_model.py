"""Whitened residuals on data drawn from the model: independent, of unit size, whatever errs together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import kicks_of, uncertainty_at
from analysis.residuals.noise.whitening import Whitener, step_losses
from analysis.residuals.plate_data.plate_observables import GAIN, PHASE
from analysis.residuals.values import TREND
from analysis.thresholds import SHARED_S
from model.effects.registry import accelerometer_response

FRICTION = {("coulomb_friction", "mu_up"): 0.15, ("coulomb_friction", "mu_down"): 0.15}
CLOSES_LATE = ("contact_closure", "late_s")
SEEDS = range(4)


def test_residuals_at_the_truth_are_unit_normal_once_whitened(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Edges, carried errors and tones together: Kolmogorov-Smirnov on four runs, and the plate data likewise."""
    events, plate = [], []
    for seed in SEEDS:
        model = fly_ramp(FRICTION, seed)
        whitener = Whitener.of(model, FRICTION)
        z, p = whitener.white(model.residuals(FRICTION))
        events.append(z)
        plate.append(p)
        assert max(whitener.excess_s) < 2e-6
    z = np.concatenate(events)
    assert np.std(z) == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * len(z)) + 0.02)
    assert stats.kstest(z, "norm").pvalue > 1e-3
    assert stats.kstest(np.concatenate(plate), "norm").pvalue > 1e-3


@pytest.mark.parametrize("times", [3.0, 8.0])
def test_what_a_step_shares_is_taken_out(fly_ramp: Callable[..., ForwardModel], times: float) -> None:
    """Tones err for a whole step, some by far more than edges: bare residuals of steps differ, whitened ones do not."""
    model = fly_ramp(FRICTION, 3)
    sigma = times * model.observations.steps.sigma_mps2
    rng = np.random.default_rng(0)
    steps = model.observations.steps
    noise = (rng.standard_normal(sigma.shape) + 1j * rng.standard_normal(sigma.shape)) * sigma * steps.forcing
    shaken = replace(steps.plate, acceleration_mps2=steps.plate.acceleration_mps2 + noise)
    steps = replace(steps, plate=shaken, spread_mps2=times * steps.spread_mps2)
    model = ForwardModel(replace(model.observations, steps=steps), {})
    whitener = Whitener.of(model, FRICTION)
    r = model.residuals(FRICTION)
    z, _ = whitener.white(r)
    bare = whitener.stacked(r)[: len(z)] / whitener.weights.sd

    def between(x: np.ndarray) -> float:
        return float(stats.f_oneway(*(x[whitener.step == s] for s in np.unique(whitener.step))).pvalue)

    assert between(bare) < 1e-12
    assert between(z) > 1e-3


def test_weights_are_near_only_with_those_of_the_plate(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A fit is settled when edges and plate data both keep their weights."""
    whitener = Whitener.of(fly_ramp(FRICTION, 1), FRICTION)
    assert whitener.near(whitener)
    assert not replace(whitener, plate_sigma=2.0 * whitener.plate_sigma).near(whitener)


def test_a_microsecond_that_a_step_shares_is_no_evidence(fly_ramp: Callable[..., ForwardModel]) -> None:
    """However sharp the edges: all landings of a step off by what the circuit may do count as one unit, not as many."""
    made = fly_ramp(FRICTION, 1).observations
    sharp = np.full(len(made), 5e-8)
    model = ForwardModel(replace(made, landing_sigma_s=sharp, opening_sigma_s=sharp), {})
    whitener, r = Whitener.of(model, FRICTION, lean=True), model.residuals(FRICTION)
    off = replace(r, opening_s=np.zeros(len(made)), landing_s=np.full(len(made), SHARED_S), plate=0.0 * r.plate)
    z, _ = whitener.white(off)
    assert np.all(np.bincount(whitener.step, z**2) < 2.5)


def test_the_truth_loses_least(fly_ramp: Callable[..., ForwardModel]) -> None:
    """By step and in sum, friction's own size beats a tenth less and a tenth more on the same weights."""
    model = fly_ramp(FRICTION, 1)
    whitener = Whitener.of(model, FRICTION)

    def loss(part: float) -> float:
        values = {k: part * v for k, v in FRICTION.items()}
        return float(sum(x.sum() for x in step_losses(model, whitener, model.residuals(values)).values()))

    assert loss(1.0) < min(loss(0.9), loss(1.1)) - 20.0


def test_a_drifting_parameter_has_its_value_in_the_middle_of_the_run(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A trend moves rows in proportion to the place in the run, and never beyond the parameter's bounds."""
    model = fly_ramp({}, 0)
    mu = ("coulomb_friction", "mu_up")
    plain, trend = model.rows({mu: 0.1}), model.rows({mu: 0.1, ("coulomb_friction", "mu_up@drift"): 0.6})
    change = (trend - plain).sum(axis=1)
    part = model.observations.steps.run_part[model.observations.measured.step]
    assert change == pytest.approx(np.maximum(0.6 * part, -0.1))


def test_a_plate_mode_that_only_drifts_rings(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A resonance that is nothing amid the run and something at its ends has uncertainties like any other."""
    mode = {("table_resonance", "frequency_hz"): 7.5, ("table_resonance", "damping"): 0.04}
    model = fly_ramp({}, 1)
    drifting = mode | {("table_resonance", "mass_ratio"): 0.0, ("table_resonance", "mass_ratio" + TREND): 0.02}
    steady = mode | {("table_resonance", "mass_ratio"): 0.01}
    assert np.array(kicks_of(model, drifting)) == pytest.approx(np.array(kicks_of(model, steady)), rel=0.3)
    assert np.all(np.isfinite(uncertainty_at(model, drifting).landing_total_s))
    assert kicks_of(model, mode) == ()


def test_tones_are_taken_back_to_the_plates_own(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Beside a lag and a gain of the accelerometer each tone of the plate is earlier and smaller than it is shown."""
    model = fly_ramp({}, 0)
    plate = model.observations.steps.plate
    values = {("accelerometer_lag", "delay_s"): 4e-4, ("accelerometer_gain", "relative"): 0.1}
    own = plate.acceleration_mps2 / (1.1 * np.exp(-4e-4j * plate.omega_radps))
    assert model.inputs(values).plate.acceleration_mps2 == pytest.approx(own)
    drifting = values | {("accelerometer_gain", "relative" + TREND): 0.02}
    gain = 1.1 + 0.02 * model.observations.steps.run_part[:, None]
    assert model.inputs(drifting).plate.acceleration_mps2 == pytest.approx(own * 1.1 / gain)


def test_a_mains_line_that_a_cable_picked_up_is_no_motion(fly_ramp: Callable[..., ForwardModel]) -> None:
    """With mains in the cable the plate has no line at 50 Hz nor at 150 Hz, and every other tone as it was shown."""
    model = fly_ramp({}, 0)
    steps = model.observations.steps
    omega, shown = steps.plate.omega_radps.copy(), steps.plate.acceleration_mps2.copy()
    omega[:, -2:], shown[:, -2:] = 2.0 * np.pi * 49.97 * np.array([3.0, 1.0]), (0.1 + 0.2j, 0.4 + 0.3j)
    heard = replace(steps, plate=replace(steps.plate, omega_radps=omega, acceleration_mps2=shown))
    model = ForwardModel(replace(model.observations, steps=heard), {})
    moved = model.inputs({("mains_pickup", "amplitude_mps2"): 0.5}).plate.acceleration_mps2
    assert not moved[:, -2:].any()  # not even a part of a mode is taken from them
    assert np.array_equal(moved[:, :-2], shown[:, :-2])


def test_mains_on_a_driven_tone_are_taken_from_it_and_from_no_other(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A driven tone moves by what it shows without the mains, and its gain and phase show them."""
    seen = fly_ramp({}, 0).observations
    data, shown = seen.plate, seen.steps.plate.acceleration_mps2
    own = np.isin(data.kind, (GAIN, PHASE)) & (data.multiple == 1)
    model = ForwardModel(replace(seen, plate=replace(data, mains=np.where(own, 0.02 - 0.01j, 0.0))), {})
    pickup, factor = {("mains_pickup", "amplitude_mps2"): 0.5}, 1.01 - 0.005j
    moved = model.inputs(pickup).plate.acceleration_mps2
    those = np.unique(data.step[own])
    assert moved[those, 0] == pytest.approx(shown[those, 0] / factor)
    assert np.array_equal(moved[:, 1:], shown[:, 1:])
    added = model.residuals({}).plate - model.residuals(pickup).plate
    wanted = np.where(data.kind == GAIN, np.log(abs(factor)), np.angle(factor))
    assert added[own] == pytest.approx(wanted[own]) and not added[~own].any()


def test_a_parameter_drifts_within_a_step_too(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A trend is followed from flight to flight: a change within a long step is no scatter."""
    made = fly_ramp({}, 0).observations
    part = np.linspace(-0.5, 0.5, len(made))
    mu = ("coulomb_friction", "mu_up")
    rows = ForwardModel(replace(made, run_part=part), {}).rows({mu: 0.3, (mu[0], mu[1] + TREND): 0.2})
    assert np.ptp((rows - rows[0]).sum(axis=1) - 0.2 * part) < 1e-12


def test_impacts_heard_late_leave_the_residuals_they_would_have_in_time(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Landings, and the take-offs at them, shown late only by the accelerometer: a known delay takes it all back."""
    model, late_s = fly_ramp(FRICTION, 1), 2e-4
    made = model.observations
    heard = np.arange(len(made)) % 3 > 0
    left = made.measured.relaunched & np.append(False, heard[:-1])
    shown = replace(
        made.measured,
        landing_s=made.measured.landing_s + late_s * heard,
        opening_s=made.measured.opening_s + late_s * left,
    )
    late = ForwardModel(replace(made, measured=shown, circuit=replace(made.circuit, heard=heard)), {})
    key = ("accelerometer_lag", "impact_s")
    in_time, found = model.residuals(FRICTION), late.residuals({**FRICTION, key: late_s})
    np.testing.assert_allclose(found.landing_s, in_time.landing_s, atol=1e-9)
    np.testing.assert_allclose(found.opening_s, in_time.opening_s, atol=1e-9)
    assert model.is_idle(key)
    assert not late.is_idle(key)


def test_closings_later_than_openings_leave_the_residuals_they_would_have_in_time(
    fly_ramp: Callable[..., ForwardModel],
) -> None:
    """Landings, and the launches at them, seen late by a contact that chatters: a known delay takes it all back."""
    model, late_s = fly_ramp(FRICTION, 1), 3e-5
    made = model.observations
    shown = replace(
        made.measured,
        landing_s=made.measured.landing_s + late_s,
        opening_s=made.measured.opening_s + late_s * made.measured.relaunched,
    )
    late = ForwardModel(replace(made, measured=shown), {})
    in_time, found = model.residuals(FRICTION), late.residuals({**FRICTION, CLOSES_LATE: late_s})
    np.testing.assert_allclose(found.landing_s, in_time.landing_s, atol=1e-9)
    np.testing.assert_allclose(found.opening_s, in_time.opening_s, atol=1e-9)


def test_closings_tell_of_no_delay_of_their_own_where_no_ball_leaves_from_rest(
    fly_ramp: Callable[..., ForwardModel],
) -> None:
    """Without openings a closing that is late is a late accelerometer; even edges have no delay between them."""
    even = fly_ramp(FRICTION, 1).observations
    uneven = replace(even, circuit=replace(even.circuit, uneven=True))
    never = replace(uneven, measured=replace(even.measured, relaunched=np.ones(len(even), dtype=bool)))
    assert [ForwardModel(x, {}).is_idle(CLOSES_LATE) for x in (uneven, even, never)] == [False, True, True]


@pytest.mark.parametrize(
    ("key", "size"), [(("accelerometer_lag", "delay_s"), 2e-4), (("accelerometer_high_pass", "corner_hz"), 3.0)]
)
def test_an_accelerometer_shows_impacts_as_late_or_early_as_the_motion(
    fly_ramp: Callable[..., ForwardModel], key: tuple[str, str], size: float
) -> None:
    """Where it alone shows landings, a lag or a lead moves take-offs from rest, and no landing against the plate."""
    model = fly_ramp(FRICTION, 1)
    made, plate = model.observations, model.observations.steps.plate
    response = accelerometer_response({key[0]: {key[1]: size}}, plate.omega_radps)
    late_s = (-np.angle(response) / plate.omega_radps)[0, 0]
    assert abs(late_s) > 1e-4
    heard = np.ones(len(made), dtype=bool)
    left = made.measured.relaunched & np.append(False, heard[:-1])
    shown = replace(
        made.measured,
        landing_s=made.measured.landing_s + late_s,
        opening_s=made.measured.opening_s + late_s * left,
    )
    steps = replace(made.steps, plate=replace(plate, acceleration_mps2=plate.acceleration_mps2 * response))
    late = ForwardModel(replace(made, measured=shown, circuit=replace(made.circuit, heard=heard), steps=steps), {})
    in_time, found = model.residuals(FRICTION), late.residuals({**FRICTION, key: size})
    np.testing.assert_allclose(found.landing_s, in_time.landing_s, atol=1e-9)
    np.testing.assert_allclose(found.opening_s, in_time.opening_s, atol=1e-9)
