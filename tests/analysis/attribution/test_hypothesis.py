"""Intervals allow for what effects can hide; the verdict's fit is led to the bottom of a valley."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.attribution.candidates import Candidate, Prior, priors_of
from analysis.attribution.choice import contained_in
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import SETTLED, Hypothesis, Refits, to_the_bottom, with_hidden_free
from analysis.flights.assemble import flights_of
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import observed
from analysis.residuals.values import ParameterId
from benchmarks.analysis.ringing import drawn
from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported
from daq.recording import open_recording

CORNER, LAG = ("accelerometer_high_pass", "corner_hz"), ("accelerometer_lag", "delay_s")
UP, DOWN = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")
GAIN, SCALE = ("drive_gain", "relative"), ("accelerometer_gain", "relative")
DRAG = ("quadratic_drag", "k_per_m")


def _fitted(fitter: Fitter, *free: ParameterId) -> Hypothesis:
    candidates = tuple(Candidate((key[0],), (key,)) for key in free)
    return Refits(fitter).converged(candidates, Whitener.of(fitter.model, {}), free, {})


def test_the_low_pass_that_a_high_pass_hides_is_allowed_for(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A corner of 1 Hz fitted without the lag is sure and wrong; with the lag free, its interval holds 1 Hz."""
    sure = _fitted(fitter_of(fly_ramp({CORNER: 1.0, LAG: 4e-5}, 6)), CORNER)
    allowed = with_hidden_free(sure)
    assert allowed.names == sure.names and LAG in allowed.fitted.keys
    assert abs(sure.fitted.values[CORNER] - 1.0) > 3.0 * sure.fitted.sigma(CORNER)
    assert abs(allowed.fitted.values[CORNER] - 1.0) < 2.0 * allowed.fitted.sigma(CORNER)


def test_what_hides_nothing_stays_as_it_is(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A drag hides no instrument's effect; a high-pass hides none either where the lag is named."""
    fitter = fitter_of(fly_ramp({}, 6))
    for found in (_fitted(fitter, DRAG), _fitted(fitter, CORNER, LAG)):
        assert with_hidden_free(found) is found


def test_a_settled_fit_stays_where_it_is_when_it_is_repeated(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Frictions and the accelerometer's scale trade places: a fit from afar moves when repeated, a settled one not."""
    scale = ("accelerometer_gain", "relative")
    model = fly_ramp({UP: 0.12, DOWN: 0.18, scale: 0.008}, 3, gammas=(0.5, 0.9, 0.7, 1.2))
    refits = Refits(Fitter(model, priors_of(model.observations.setup), np.ones(4, dtype=bool)))
    candidate = Candidate(("coulomb_friction",), (UP, DOWN))
    whitener = Whitener.of(model, {})
    far = refits.scored((candidate,), refits.fitter.fit(whitener, (UP, DOWN), {UP: 0.3, DOWN: 0.02}))
    settled = refits.settled(far)

    def moved(x: Hypothesis) -> float:
        again = refits.again(x).fitted
        return max(abs(again.values[k] - x.fitted.values[k]) / again.sigma(k) for k in (UP, DOWN))

    assert moved(far) > SETTLED > moved(settled)
    declared = refits.converged((), Whitener.of(model, {}), (), {})
    assert refits.settled(declared) is declared


def test_a_constant_pull_is_a_gravity() -> None:
    """A pull of a range beyond all heights needs no magnet: the search tries the place's gravity instead."""
    assert "local_gravity" in contained_in(("position_force",))


@pytest.mark.parametrize("off", [0.02, -0.02])
def test_frictions_that_a_scale_can_hide_in_are_followed_to_the_bottom(
    fly_ramp: Callable[..., ForwardModel], off: float
) -> None:
    """Of a drive whose gain nobody states, the fit begins where friction and the accelerometer's scale traded places:
    damped steps hardly leave it, though the bottom is two nats deeper and two standard deviations away."""
    truth = {UP: 0.12, DOWN: 0.12}
    model = fly_ramp(truth, 0)
    priors = {**priors_of(model.observations.setup), GAIN: Prior(0.0, 10.0), SCALE: Prior(0.0, 0.01)}
    fitter = Fitter(model, priors, np.ones(len(model.observations.steps), dtype=bool))
    traded = {UP: 0.12 - off, DOWN: 0.12 + off, SCALE: off, GAIN: -off}
    short = fitter.fit(Whitener.of(model, truth), (UP, DOWN), traded)
    assert abs(short.values[UP] - 0.12) > 1.5 * short.sigma(UP)
    refits, friction = Refits(fitter), Candidate(("coulomb_friction",), (UP, DOWN))
    deep = to_the_bottom(short)
    for fitted in (deep, refits.settled(refits.scored((friction,), short)).fitted):
        assert fitted.loss < short.loss - 1.5
        for key, value in truth.items():
            assert fitted.values[key] == pytest.approx(value, abs=0.2 * fitted.sigma(key))
    assert to_the_bottom(deep) is deep


def test_a_step_of_grazing_flights_does_not_hold_a_fit_that_all_others_lead_on(tmp_path: Path) -> None:
    """In one of 27 steps the ball flies for nearly all of the time, and its own landings would hold a fit where they
    are missed: from far off, too, the search comes to where it ends if it begins at the truth (decision 741)."""
    mode = {"table_resonance.hz": 4.4273, "table_resonance.damping": 0.0276, "table_resonance.ratio": 0.0886}
    run = replace(drawn(152016, without=False), hidden={**mode, "coulomb_friction.mu": 0.0463})
    path = imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path)
    with open_recording(path) as recording:
        model = ForwardModel(observed(recording, flights_of(recording)), {})
    fitter = Fitter(model, priors_of(model.observations.setup), np.ones(len(model.observations.steps), dtype=bool))
    refits, measured = Refits(fitter), {k: v for k, (v, _) in model.observations.ringing.mode.measured().items()}
    free = (*measured, UP, DOWN, LAG)
    traded = {**measured, UP: 0.035, DOWN: 0.058, LAG: 4.2e-5, SCALE: 0.01, GAIN: -0.01}
    farther = {**measured, UP: 0.01, DOWN: 0.09, LAG: 2e-4, SCALE: 0.035, GAIN: -0.035}
    true = {**measured, UP: 0.0463, DOWN: 0.0463, LAG: 4.2e-5}
    right, *others = (
        refits.converged((Candidate(("coulomb_friction",), free),), Whitener.of(model, start), free, start)
        for start in (true, traded, farther)
    )
    for other in others:
        assert other.fitted.loss < right.fitted.loss + 1.0
        assert refits.settled(other).fitted.loss < right.fitted.loss + 1.0


@pytest.mark.parametrize(("mu_down", "numbers"), [(0.05, 1), (0.02, 2)])
def test_two_frictions_that_may_be_equal_are_one_number(
    fly_ramp: Callable[..., ForwardModel], mu_down: float, numbers: int
) -> None:
    """A friction that is the same both ways is as simple as a gravity, and comes before a magnet with its range."""
    model = fly_ramp({UP: 0.05, DOWN: mu_down}, 3)
    train = np.ones(len(model.observations.steps), dtype=bool)
    fitter = Fitter(model, {}, train)
    both = (Candidate(("coulomb_friction",), (UP, DOWN)),)
    fitted = Refits(fitter).converged(both, Whitener.of(model, {}), (UP, DOWN), {UP: 0.04, DOWN: 0.04})
    assert fitted.numbers == numbers
