"""The robust loss: what a single residual may say, and the scatter that belongs to a whole channel."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.residuals.noise.noise_model import (
    NEVER,
    PlateNoise,
    excess_noise,
    log_odds,
    robust_curvature,
    robust_loss,
    robust_weight,
)
from analysis.thresholds import LEAST_EXCESS_S


@pytest.mark.parametrize("odds", [NEVER, -6.0])
def test_the_weight_is_the_slope_of_the_loss_over_the_residual(odds: float) -> None:
    """Least squares with these weights go down the very loss: its derivative, by brute force."""
    z, h = np.linspace(-9.0, 9.0, 37), 1e-6
    slope = (robust_loss(z + h, odds) - robust_loss(z - h, odds)) / (2 * h)
    assert robust_weight(z, odds) * z == pytest.approx(slope, abs=1e-7)


@pytest.mark.parametrize("odds", [NEVER, -6.0])
def test_the_curvature_is_the_slope_of_the_slope(odds: float) -> None:
    """Second derivative of the loss, by brute force from its first."""
    z, h = np.linspace(-9.0, 9.0, 37), 1e-5
    up, down = (robust_weight(x, odds) * x for x in (z + h, z - h))
    assert robust_curvature(z, odds) == pytest.approx((up - down) / (2 * h), abs=1e-7)


def test_another_event_costs_the_same_however_far_it_is() -> None:
    """A flight to another landing says no more than that: its loss ends at the odds and its pull at nothing."""
    near, far = robust_loss(np.array([50.0, 5000.0]), -6.0)
    assert far == pytest.approx(near, abs=0.01)
    assert robust_weight(np.array([5000.0]), -6.0) < 1e-6


def test_scatter_beyond_the_uncertainty_is_found_and_an_honest_one_is_left_alone() -> None:
    """40 us where 10 us are claimed need an excess of 39; 10 us need next to none, a lost event among them or not."""
    rng = np.random.default_rng(4)
    sigma, period = np.full(400, 1e-5), np.full(400, 0.04)
    loud, honest = 4e-5 * rng.standard_normal(400), 1e-5 * rng.standard_normal(400)
    honest[::50] = 0.01
    assert excess_noise(loud, sigma, period)[0] == pytest.approx(3.9e-5, rel=0.15)
    assert excess_noise(honest, sigma, period)[0] < 3e-6
    assert excess_noise(np.zeros(0), sigma[:0], period[:0]) == (LEAST_EXCESS_S, 0.0)


def test_odds_are_a_density_against_a_density() -> None:
    """A wider hit makes "another event" likelier in proportion, a longer period less so."""
    assert log_odds(np.array([2e-5]), np.array([0.04])) - log_odds(np.array([1e-5]), np.array([0.04])) == (
        pytest.approx(np.log(2.0))
    )
    assert log_odds(np.array([1e-5]), np.array([0.08])) < log_odds(np.array([1e-5]), np.array([0.04]))


def test_each_kind_of_plate_datum_has_an_excess_of_its_own() -> None:
    """Gains that scatter tenfold do not widen honest phases."""
    rng = np.random.default_rng(1)
    kind = np.repeat([0, 1], 60)
    residual = 1e-3 * rng.standard_normal(120) * np.where(kind == 0, 10.0, 1.0)
    scaled, log = PlateNoise.of(kind, np.full(120, 1e-3)).scaled(residual)
    assert scaled[0] == pytest.approx(1e-2, rel=0.3)
    assert scaled[-1] == pytest.approx(1e-3, rel=0.2)
    assert log == pytest.approx(np.log(scaled / 1e-3))


def test_noise_of_some_plate_data_is_in_the_order_of_their_kinds() -> None:
    """Mixed kinds, some of them left out: rows, widths and loss are those of each kind taken alone."""
    rng = np.random.default_rng(2)
    kind, sigma = rng.integers(0, 3, 90), rng.uniform(0.5, 2.0, 90)
    residual, among = 3.0 * rng.standard_normal(90), rng.random(90) < 0.7
    noise = PlateNoise.of(kind, sigma, among)
    wide, _ = noise.scaled(residual)
    apart = [PlateNoise.of(kind[rows], sigma[rows]) for k in range(3) if (rows := among & (kind == k)).any()]
    alone = [x.scaled(residual[among & (kind == k)])[0] for k, x in enumerate(apart)]
    assert np.array_equal(kind[noise.rows], np.sort(kind[among]))
    assert wide == pytest.approx(np.concatenate(alone))
    assert noise.loss(residual) == pytest.approx(
        sum(x.loss(residual[among & (kind == k)]) for k, x in enumerate(apart))
    )
