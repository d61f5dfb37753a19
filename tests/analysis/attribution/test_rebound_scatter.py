"""A restitution that scatters, from landings after rebounds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import laplace, norm

from analysis.attribution.candidates import Candidate
from analysis.attribution.fit import Fitter
from analysis.attribution.rebound_scatter import Rebounds, scatter_of
from analysis.attribution.selection import StepwiseSelection
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import T_PEAK
from analysis.residuals.noise.uncertainty import slope_by_rebound, uncertainty_at
from analysis.residuals.prediction_errors import near_grazing
from analysis.thresholds import FROZEN, OUTLIER_FRACTION

E0 = ("restitution", "e0")
SD = 0.02


def rebounds(rng: np.random.Generator, sd: float, n: int = 4000) -> Rebounds:
    """Landings missed by what the restitution scatters, and by normal errors of a third of the stated size."""
    slope, sigma = rng.uniform(0.002, 0.08, n), rng.uniform(2e-5, 2e-4, n)
    missed = slope * rng.laplace(0.0, sd / math.sqrt(2.0), n) + sigma / 3.0 * rng.standard_normal(n)
    return Rebounds(missed, sigma, np.zeros((n, 1)), slope, np.full(n, 0.04), np.arange(n) // 20)


@pytest.mark.parametrize("missed_s", [0.0, 3e-5, -4e-4, 3e-3])
def test_the_density_is_that_of_a_two_sided_exponential_blurred_by_a_normal_one(missed_s: float) -> None:
    """Against the integral of both, outliers included."""
    slope, sigma = 0.02, 1e-4
    scale = slope * SD / math.sqrt(2.0)
    blurred, _ = quad(
        lambda x: laplace.pdf(x, scale=scale) * norm.pdf(missed_s - x, scale=sigma), -0.02, 0.02, points=[0.0, missed_s]
    )
    outlier = OUTLIER_FRACTION / (1.0 - OUTLIER_FRACTION) / 0.04
    alone = np.array([missed_s]), np.array([sigma]), np.zeros((1, 1)), np.array([slope])
    one = Rebounds(*alone, np.array([0.04]), np.zeros(1, dtype=np.int64))
    assert one.loss(SD, 1.0) == pytest.approx(-math.log((blurred + outlier) / T_PEAK), rel=1e-6)


def test_the_scatter_is_found_where_uncertainties_are_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forty times: clear, and off by no more than its standard deviation says."""
    found = []
    for seed in range(40):
        seen = rebounds(np.random.default_rng(seed), SD, 400)
        monkeypatch.setattr(Rebounds, "of", classmethod(lambda cls, x, seen=seen: seen))
        scatter = scatter_of(None)  # type: ignore[arg-type]
        assert scatter is not None and scatter.is_clear(FROZEN)
        found.append((scatter.sd - SD) / scatter.sigma)
    # the sample standard deviation of forty has an error of a ninth
    assert abs(np.mean(found)) < 0.5 and 0.7 < np.std(found) < 1.3


def test_the_motions_own_scatter_is_not_taken_for_jitter_of_the_contact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jitter of 70 us that repeated cycles seem to show, none of it the contact's, makes no scatter smaller."""
    found = []
    for seed in range(20):
        rng, n = np.random.default_rng(seed), 400
        slope, sigma = rng.uniform(0.002, 0.04, n), rng.uniform(2e-6, 1e-5, n)
        missed = slope * rng.laplace(0.0, 0.00875 / math.sqrt(2.0), n) + sigma * rng.standard_normal(n)
        columns = missed, sigma, np.zeros((n, 1)), slope, np.full(n, 0.04), np.arange(n) // 20
        seen = Rebounds(*columns, np.full(n, 7e-5))
        monkeypatch.setattr(Rebounds, "of", classmethod(lambda cls, x, seen=seen: seen))
        scatter = scatter_of(None)  # type: ignore[arg-type]
        assert scatter is not None and scatter.is_clear(FROZEN)
        found.append((scatter.sd - 0.00875) / scatter.sigma)
    assert abs(np.mean(found)) < 0.7 and 0.5 < np.std(found) < 1.5


def test_normal_errors_of_another_size_are_no_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Uncertainties stated three times too large, and no scatter: nothing is gained by one."""
    seen = rebounds(np.random.default_rng(1), 0.0)
    monkeypatch.setattr(Rebounds, "of", classmethod(lambda cls, x: seen))
    scatter = scatter_of(None)  # type: ignore[arg-type]
    assert scatter is not None and scatter.gain < 1.0 and not scatter.is_clear(FROZEN)


def test_what_all_landings_of_a_step_are_missed_by_is_no_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    """In one step of a long cycle the tones' error moves every landing by 30 us: that was called a scatter of .0001."""
    rng = np.random.default_rng(3)
    n, step = 280, np.arange(280) // 14
    slope, own = rng.uniform(0.002, 0.03, n), rng.uniform(6e-6, 9e-6, n)
    shared = np.zeros((n, 1))
    slope[step == 4], shared[step == 4] = 0.1, 1.2e-5
    missed = 0.6 * own * rng.standard_normal(n) + 2.2 * shared[:, 0]
    seen = Rebounds(missed, own, shared, slope, np.full(n, 0.04), step)
    monkeypatch.setattr(Rebounds, "of", classmethod(lambda cls, x: seen))
    found = scatter_of(None)  # type: ignore[arg-type]
    assert found is not None and found.sd > FROZEN.next_effect_sigmas * found.sigma and not found.is_clear(FROZEN)


def test_a_ball_that_rebounds_evenly_scatters_by_nothing(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """Flights of one restitution, blurred as they claim: no scatter is clear; of a ball that stays there is none."""
    model = fly_ramp({E0: 0.35}, 3)
    selection = StepwiseSelection(model, fitter_of(model))
    nothing = selection.declared()
    best = selection.refits.converged((Candidate(("restitution",), (E0,)),), nothing.whitener, (E0,), {E0: 0.34})
    even = scatter_of(best)
    assert even is not None and not even.is_clear(FROZEN)
    assert scatter_of(nothing) is None


def test_a_scatter_widens_landings_after_rebounds_by_what_it_moves_them(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Half the change of a landing between restitutions one scatter above and below; take-offs and others stay."""
    model, sd = fly_ramp({E0: 0.35}, 3, declared={"restitution_scatter": {"sd": 1e-3}}), 1e-3
    at = {E0: 0.35}
    plain, wide = (uncertainty_at(m, at) for m in (ForwardModel(model.observations, {}), model))
    up, down = (model.predict({E0: 0.35 + sign * sd}).landing_s for sign in (1.0, -1.0))
    firm = model.observations.scored & ~near_grazing(model, at) & np.isfinite(up - down)
    rebound = firm & model.observations.measured.relaunched & (np.abs(up - down) < 1e-3)
    assert rebound.sum() > 30
    assert wide.landing_scatter_s[rebound] == pytest.approx(0.5 * np.abs(up - down)[rebound], rel=0.1, abs=1e-6)
    total = np.hypot(plain.landing_total_s, wide.landing_scatter_s)
    assert wide.landing_total_s == pytest.approx(total, rel=1e-9)
    assert np.array_equal(wide.opening_total_s, plain.opening_total_s)
    assert not np.any(slope_by_rebound(model, {}))  # without a rebound there is nothing to scatter
