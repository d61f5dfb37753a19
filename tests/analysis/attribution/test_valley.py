"""Fits led on along a valley."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from analysis.attribution.candidates import Candidate, Prior, priors_of
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Refits
from analysis.attribution.valley import to_the_bottom
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener

UP, DOWN = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")
GAIN, SCALE = ("drive_gain", "relative"), ("accelerometer_gain", "relative")


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
