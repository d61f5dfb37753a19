"""The best of all candidates by chance: known distributions, blocks that scatter, and fitted runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from analysis.attribution.candidates import candidates_of
from analysis.attribution.chance import ChanceGains, ScoreSpace, fitted_gain, generator_of, places
from analysis.attribution.fit import Fitter
from analysis.attribution.selection import StepwiseSelection
from analysis.residuals.forward_model import ForwardModel
from analysis.thresholds import FROZEN

ROWS, DRAWS = 400, 20000


def space(columns: np.ndarray, groups: list[tuple[int, ...]], signs: list[int] | None = None) -> ScoreSpace:
    """Candidates beside one nuisance, the mean of all residuals."""
    return ScoreSpace.of(np.ones((ROWS, 1)), np.zeros(1), columns, groups, signs or [0] * columns.shape[1])


def unlike(n: int) -> np.ndarray:
    """Columns that no other and no nuisance can follow, (ROWS, n)."""
    return np.linalg.qr(np.column_stack([np.ones(ROWS), np.random.default_rng(1).standard_normal((ROWS, n))]))[0][:, 1:]


@pytest.mark.parametrize("n", [1, 12])
def test_unlike_candidates_count_each(n: int) -> None:
    """The best of n independent candidates: the n-th root of the probability of one, Wilks."""
    gains = space(unlike(n), [(j,) for j in range(n)]).by_noise(np.random.default_rng(2), DRAWS)
    for p in (0.5, 0.05, 0.01):
        expected = 0.5 * chi2.ppf((1.0 - p) ** (1.0 / n), 1)
        assert np.quantile(gains, 1.0 - p) == pytest.approx(expected, rel=0.08)


def test_candidates_alike_count_once() -> None:
    """Twelve copies of one signature gain by chance what one gains."""
    columns = np.repeat(unlike(1), 12, axis=1)
    gains = space(columns, [(j,) for j in range(12)]).by_noise(np.random.default_rng(2), DRAWS)
    assert np.quantile(gains, 0.99) == pytest.approx(0.5 * chi2.ppf(0.99, 1), rel=0.08)


def test_two_parameters_gain_more_and_one_direction_less() -> None:
    """A pair of parameters follows chi-square of two; a friction that cannot be negative gains in half of the draws."""
    pair = space(unlike(2), [(0, 1)]).by_noise(np.random.default_rng(2), DRAWS)
    assert np.quantile(pair, 0.99) == pytest.approx(0.5 * chi2.ppf(0.99, 2), rel=0.08)
    bound = space(unlike(1), [(0,)], [1]).by_noise(np.random.default_rng(2), DRAWS)
    assert np.mean(bound > 0.0) == pytest.approx(0.5, abs=0.02)
    assert np.quantile(bound, 0.99) == pytest.approx(0.5 * chi2.ppf(0.98, 1), rel=0.08)


def test_what_a_nuisance_can_follow_gains_nothing() -> None:
    """A candidate that is the nuisance itself has no information and is left out."""
    found = space(np.full((ROWS, 1), 3.0), [(0,)])
    assert found.groups == ()
    assert not np.any(found.by_noise(np.random.default_rng(2), 100))


def test_steps_that_scatter_more_than_stated_gain_more_by_chance() -> None:
    """Residuals whose steps are off together by three times the noise: signs by step know it, stated noise does not."""
    rng, step = np.random.default_rng(3), np.repeat(np.arange(20), ROWS // 20)
    found = space(np.eye(20)[step][:, :10] - 0.5 * np.eye(20)[step][:, 10:], [(j,) for j in range(10)])
    quiet = rng.standard_normal(ROWS)
    loud = quiet + 3.0 * rng.standard_normal(20)[step]
    known = np.quantile(found.by_noise(rng, DRAWS), 0.99)
    assert np.quantile(found.by_steps(quiet, step, rng, DRAWS), 0.99) < 1.5 * known
    assert np.quantile(found.by_steps(loud, step, rng, DRAWS), 0.99) > 3.0 * known


def test_the_recording_fixes_the_draws(fly_ramp: Callable[..., ForwardModel]) -> None:
    """The same flights draw the same numbers, others draw others."""
    model = fly_ramp({}, 1, gammas=(0.5, 0.9))
    measured = model.observations.measured
    moved = replace(model.observations, measured=replace(measured, landing_s=measured.landing_s + 1e-6))
    first, again, other = (generator_of(w).random() for w in (model, model, ForwardModel(moved, {})))
    assert first == again != other


def test_places_are_distinct_settings_of_shapes_without_what_is_free(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """Sizes once for each setting of a candidate's shapes; nothing of what the hypothesis frees already."""
    model = fly_ramp({}, 1, gammas=(0.5, 0.9))
    selection = StepwiseSelection(model, fitter_of(model))
    stribeck = next(c for c in candidates_of(model) if c.names == ("stribeck_friction",))
    found = places([stribeck], selection.declared())
    assert len(found) == len(set(found)) == 6
    assert all(len(group) == 2 for group in found)


@pytest.mark.parametrize(("mu", "chance"), [(0.0, True), (0.05, False)])
def test_a_cause_stands_against_chance_and_noise_does_not(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter], mu: float, chance: bool
) -> None:
    """Friction of 0.05 gains what no draw does; on a clean run friction gains what the best of all often does."""
    truth = {("coulomb_friction", "mu_up"): mu, ("coulomb_friction", "mu_down"): mu}
    model = fly_ramp(truth, 2, gammas=(0.5, 1.1, 0.8, 1.3, 0.65, 0.95))
    selection = StepwiseSelection(model, fitter_of(model))
    before, friction = selection.declared(), next(c for c in selection.library if c.names == ("coulomb_friction",))
    free = (*before.free, *friction.free)
    x = selection.refits.converged((friction,), before.whitener, free, dict.fromkeys(friction.free, mu))
    null = ChanceGains(before, selection.library, generator_of(model), draws=1999)
    test = null.test(x, [x], FROZEN.best_of_all_p)
    assert test is not None and test.gain == fitted_gain(before, x) and test.p == null.p(x)
    assert (test.p > 0.05) if chance else (test.p == 1.0 / 2000.0)
    assert 5.0 < test.critical < 25.0
