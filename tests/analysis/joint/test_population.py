"""The hierarchical combination of runs: as one large least-squares problem, and spreads as they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.joint.population import Priors, Quadratic, at_spread, each_on_its_own, fit_population

Q, SHARED = 3, 2


def linear_run(rng, calibrations, shared, n=30):
    """Unit-noise data linear in a run's calibrations and in what is shared; its quadratic, and the data."""
    slopes = rng.standard_normal((n, Q + SHARED))
    data = slopes @ np.concatenate([calibrations, shared]) + rng.standard_normal(n)
    origin = rng.standard_normal(Q + SHARED)
    origin[Q:] = 0.0
    return Quadratic(origin, slopes.T @ (data - slopes @ origin), slopes.T @ slopes), slopes, data


def brute_force(made, spread, prior):
    """Means, shared parameters and every run's calibrations from one least-squares problem; values and covariance."""
    runs = len(made)
    width = Q + SHARED + runs * Q
    rows, data = [], []
    for r, (_, slopes, measured) in enumerate(made):
        block = np.zeros((len(measured), width))
        own = Q + SHARED + r * Q
        block[:, own : own + Q], block[:, Q : Q + SHARED] = slopes[:, :Q], slopes[:, Q:]
        tie = np.zeros((Q, width))
        tie[:, own : own + Q], tie[:, :Q] = np.diag(1.0 / spread), -np.diag(1.0 / spread)
        rows += [block, tie]
        data += [measured, np.zeros(Q)]
    pull = np.zeros((Q, width))
    pull[:, :Q] = np.diag(np.sqrt(prior.precision[:Q]))
    rows, data = np.vstack([*rows, pull]), np.concatenate([*data, np.sqrt(prior.precision[:Q]) * prior.mean[:Q]])
    normal = rows.T @ rows
    return np.linalg.solve(normal, rows.T @ data), np.linalg.inv(normal)


@given(st.integers(0, 10**6), st.integers(2, 6), st.floats(0.05, 3.0))
@settings(max_examples=30, deadline=None)
def test_the_combination_is_the_joint_least_squares_fit(seed, runs, size):
    """Means, shared parameters and their covariance are those of all data fitted at once."""
    rng = np.random.default_rng(seed)
    spread = size * (0.5 + rng.random(Q))
    shared = rng.standard_normal(SHARED)
    made = [linear_run(rng, spread * rng.standard_normal(Q), shared) for _ in range(runs)]
    prior = Priors(np.r_[rng.standard_normal(Q), 0.0, 0.0], np.r_[np.full(Q, 2.0), 0.0, 0.0])
    free = np.arange(Q + SHARED)
    quadratics = [run for run, _, _ in made]
    found = at_spread(quadratics, np.zeros(Q + SHARED), spread, prior, free)
    x, covariance = brute_force(made, spread, prior)
    k = Q + SHARED
    assert found.x == pytest.approx(x[:k], abs=1e-7)
    assert found.covariance == pytest.approx(covariance[:k, :k], abs=1e-7)


def test_the_spread_from_run_to_run_is_found():
    """Of three calibrations one differs between forty runs, and its spread is found; the others are common."""
    rng = np.random.default_rng(3)
    spread, mean = np.array([1.0, 0.0, 0.0]), np.array([0.3, -0.2, 0.1])
    made = [linear_run(rng, mean + spread * rng.standard_normal(Q), np.array([0.5, -0.5])) for _ in range(40)]
    prior = Priors(np.zeros(Q + SHARED), np.r_[np.ones(Q), np.zeros(SHARED)])
    found = fit_population([run for run, _, _ in made], np.zeros(Q + SHARED), np.ones(Q), prior, np.arange(Q + SHARED))
    assert found.spread[0] == pytest.approx(1.0, rel=0.35)
    assert np.all(found.spread[1:] < 0.15)
    assert found.x[Q:] == pytest.approx([0.5, -0.5], abs=4.0 * found.sigma(Q))


def test_runs_that_tell_little_do_not_widen_a_spread():
    """Of a calibration that each run knows to ten times its stated width, noise between runs is no spread."""
    rng, known = np.random.default_rng(5), np.diag([0.01, 1e4])
    prior, free = Priors(np.zeros(2), np.array([1.0, 0.0])), np.arange(2)
    for _ in range(20):
        noise = [np.sqrt(np.diag(known)) * rng.standard_normal(2) for _ in range(10)]
        runs = [Quadratic(np.zeros(2), score, known) for score in noise]
        assert fit_population(runs, np.zeros(2), np.ones(1), prior, free).spread[0] < 1.0


def test_a_spread_changes_the_weights_of_runs():
    """Where calibrations differ, a shared parameter that they can imitate is known less well than if they were one."""
    information = np.array([[100.0, 99.0], [99.0, 100.0]])
    runs = [Quadratic(np.zeros(2), np.zeros(2), information) for _ in range(10)]
    prior = Priors(np.zeros(2), np.array([1e8, 0.0]))
    one, own = (at_spread(runs, np.zeros(2), np.array([s]), prior, np.arange(2)).sigma(1) for s in (0.0, 1.0))
    assert own > 3.0 * one


def test_a_run_alone_has_its_own_value():
    """Without its tie to the mean, a run's calibration is what its data alone give."""
    rng = np.random.default_rng(4)
    truth = np.array([[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    made = [linear_run(rng, c, np.zeros(SHARED), n=2000) for c in truth]
    runs = [run for run, _, _ in made]
    prior = Priors(np.zeros(Q + SHARED), np.r_[np.ones(Q), np.zeros(SHARED)])
    found = fit_population(runs, np.zeros(Q + SHARED), np.ones(Q), prior, np.arange(Q + SHARED))
    values, sigmas = each_on_its_own(runs, found, 0)
    assert np.all(np.abs(values - truth[:, 0]) < 4.0 * sigmas)
