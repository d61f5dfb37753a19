"""A log likelihood to second order: one step with it lands where the residuals say, as surely as it states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from analysis.attribution.candidates import Prior, scale_of
from analysis.attribution.fit import Fitter
from analysis.explore.explanations import (
    adjusted_gradient_and_information,
    gradient_and_information,
    secants_at,
    slopes_at,
)
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import NEVER
from analysis.residuals.noise.whitening import Whitener


class Independent:
    """Residuals that are independent and of unit size already: most are events, the rest plate data."""

    def __init__(self, n: int, events: int) -> None:
        self.step, self.odds = np.zeros(events, dtype=np.int64), np.full(n, NEVER)

    def white_all(self, bare: np.ndarray) -> np.ndarray:
        """As they are."""
        return bare

    def white_slopes(self, slopes: np.ndarray, bare: np.ndarray) -> np.ndarray:
        """As they are."""
        return slopes


@pytest.mark.parametrize("freedom", [5.0, np.inf])
def test_one_step_is_neither_short_nor_surer_than_it_is(freedom: float) -> None:
    """Over many runs the step from nothing has no bias and scatters as stated, for normal and for Student's noise."""
    rng, true, pulls, short = np.random.default_rng(2), 0.1, [], []
    whitener = cast(Whitener, cast(Any, Independent(300, 200)))
    for _ in range(1500):
        slopes = rng.standard_normal((300, 1))
        noise = rng.standard_normal(300) if np.isinf(freedom) else rng.standard_t(freedom, 300)
        raw = noise - true * slopes[:, 0]
        gradient, information = adjusted_gradient_and_information(whitener, raw, slopes)
        pulls.append((gradient[0] / information[0, 0] - true) * np.sqrt(information[0, 0]))
        gradient, information = gradient_and_information(whitener, raw, slopes)
        short.append(gradient[0] / information[0, 0] / true)
    assert abs(np.mean(pulls)) < 0.1 and np.std(pulls) == pytest.approx(1.0, abs=0.06)
    assert np.mean(short) < 0.85


def test_a_pull_at_takeoff_is_told_by_its_secant(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Where the contact opens late, no pull shows to first order: a secant tells what a real one does."""
    pull, gap = ("adhesion", "a_mps2"), ("contact_gap", "gap_m")
    model, at = fly_ramp({}, 3), {gap: 1e-12}
    fitter = Fitter(model, {gap: Prior(0.0, 2e-6)}, np.ones(len(model.observations.steps), dtype=bool))
    whitener = Whitener.of(model, at)
    raw, slopes = slopes_at(model, fitter, whitener, at, [(pull, ())])
    secants = secants_at(model, fitter, whitener, at, [(pull, ())], raw, slopes)
    assert np.linalg.norm(secants) > 3.0 * np.linalg.norm(slopes)
    known = 1.0 / np.linalg.norm(whitener.white_slopes(slopes, raw))
    after = whitener.stacked(model.residuals({**at, pull: known * scale_of(pull)}))
    np.testing.assert_allclose(secants[:, 0] * known, after - raw, atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_derivatives_at_a_shape_are_those_of_the_model_there(
    fly_ramp: Callable[..., ForwardModel], size: float
) -> None:
    """Whether the effect has a size already or none, so that its shapes change nothing: as taken one by one."""
    ratio, shapes = ("table_resonance", "mass_ratio"), (("frequency_hz", 9.0), ("damping", 0.1))
    model = fly_ramp({}, 3)
    fitter = Fitter(model, {}, np.ones(len(model.observations.steps), dtype=bool))
    whitener, place = Whitener.of(model, {}), (ratio, tuple((("table_resonance", q), x) for q, x in shapes))
    at = {ratio: size, ("table_resonance", "frequency_hz"): 7.0, ("table_resonance", "damping"): 0.2} if size else {}
    raw, slopes = slopes_at(model, fitter, whitener, at, [place])
    there = slopes_at(model, fitter, whitener, {**at, **dict(place[1])}, [(ratio, ())])
    np.testing.assert_array_equal(slopes, there[1])
    assert np.array_equal(raw, there[0], equal_nan=True) == (size == 0.0)
