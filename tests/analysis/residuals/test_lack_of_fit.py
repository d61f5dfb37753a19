"""Tests of what is left: quiet on noise, loud on structure, and pointing at its covariate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from analysis.residuals.covariates import COVARIATES
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit, innovations, least_rms_standardised, rms_standardised
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.thresholds import FROZEN

MU = {("coulomb_friction", "mu_up"): 0.1, ("coulomb_friction", "mu_down"): 0.1}


def test_probabilities_are_those_of_noise_on_noise(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Eight runs of noise: none improbable, each test's p spread out, the covariates' like uniform ones."""
    every, scatter, serial = [], [], []
    for seed in range(8):
        model = fly_ramp(MU, seed)
        left = goodness_of_fit(model, MU)
        assert left.p_lack_of_fit > 1e-3
        assert left.covariate is None
        assert left.ratio < 1.15
        every += [left.p_covariates[k] for k in ("gamma", "takeoff_phase_rad", "time_in_run_s")]
        scatter.append(left.p_scatter)
        serial.append(left.p_serial)
    assert stats.kstest(every, "uniform").pvalue > 1e-3
    assert min(serial) > 1e-3
    assert min(scatter) > 0.05  # the scale of the noise is granted an error


@pytest.mark.parametrize("wrong", [0.0, 0.1])
def test_the_smaller_half_of_the_residuals_is_a_bound_without_a_flight(
    fly_ramp: Callable[..., ForwardModel], monkeypatch: pytest.MonkeyPatch, wrong: float
) -> None:
    """Below the whole for noise, and enough to refute a model without friction."""
    model, values = fly_ramp(MU, 2), {k: v - wrong for k, v in MU.items()}
    u = uncertainty_at(model, values)
    whole = rms_standardised(model, values, u)
    monkeypatch.setattr(model, "predict", None)
    assert least_rms_standardised(model, values, u) <= whole
    assert (least_rms_standardised(model, values, u) > FROZEN.noise_like_ratio) is (wrong > 0.0)


def test_innovations_are_independent_and_of_unit_size(fly_ramp: Callable[..., ForwardModel]) -> None:
    """An edge enters the next predictions: neighbours are correlated before, not after."""
    model = fly_ramp(MU, 2)
    found = innovations(model, MU, uncertainty_at(model, MU))
    assert np.std(found.z) == pytest.approx(1.0, abs=0.1)
    together = found.step[1:] == found.step[:-1]
    lagged = np.corrcoef(found.z[:-1][together], found.z[1:][together])[0, 1]
    assert abs(lagged) < 4.0 / np.sqrt(together.sum())


def test_a_planted_slope_is_found_and_named(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Landings late in proportion to the time in the run, half an uncertainty at its ends: seen, and in no take-off."""
    model = fly_ramp(MU, 3)
    ev, total = model.observations, uncertainty_at(model, MU).landing_total_s
    time = model.covariates(MU)["time_in_run_s"]
    part = (time - time.mean()) / np.ptp(time)
    late = ev.measured.landing_s + 2.5 * total * part
    slanted = ForwardModel(replace(ev, measured=replace(ev.measured, landing_s=late)), {})
    left = goodness_of_fit(slanted, MU)
    assert left.p_lack_of_fit < 1e-6
    assert left.covariate in ("time_in_run_s", "step_number")
    assert left.p_takeoffs > 1e-3


def test_a_missing_cause_is_far_from_noise(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Friction 0.1 left out: improbable beyond doubt, and many times the floor."""
    model = fly_ramp(MU, 4)
    left = goodness_of_fit(model, {})
    assert left.p_lack_of_fit < 1e-12
    assert left.ratio > 3.0
    assert left.covariate in COVARIATES


def test_a_rare_graze_is_no_law(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Two landings of hundreds that are milliseconds off raise no alarm by themselves."""
    model = fly_ramp(MU, 5)
    ev = model.observations
    rows = np.flatnonzero(ev.scored)[[50, 200]]
    landing = np.array(ev.measured.landing_s)
    landing[rows] += 3e-3
    # the flights that start from them are not judged: their start is wrong, not their law
    judged = ev.scored & ~np.isin(np.arange(len(ev)), np.concatenate([rows + 1, rows + 2]))
    hit = ForwardModel(replace(ev, scored=judged, measured=replace(ev.measured, landing_s=landing, wanted=judged)), {})
    assert goodness_of_fit(hit, MU).p_lack_of_fit > 1e-4


def test_the_threshold_of_a_named_covariate_is_the_callers(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A covariate that carries what is left is named at the usual threshold, and not where nothing is improbable."""
    model = fly_ramp(MU, 4, gammas=(0.5, 0.9, 0.7, 1.2))
    assert goodness_of_fit(model, {}).covariate is not None
    assert goodness_of_fit(model, {}, replace(FROZEN, lack_p=0.0)).covariate is None
