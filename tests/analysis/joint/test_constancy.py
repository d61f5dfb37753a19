"""Constancy over runs: constants pass, scatter and trends are found."""

import numpy as np

from analysis.joint.population import constancy, one_run_alone


def test_constants_pass_and_what_differs_does_not():
    """Of 500 constants about one in a hundred fails at one per cent; a step of ten sigma always does."""
    rng = np.random.default_rng(1)
    days = np.arange(12.0)
    sigmas = 0.5 + rng.random(12)
    tests = [constancy(sigmas * rng.standard_normal(12), sigmas, days) for _ in range(500)]
    assert sum(t.differs(0.01) for t in tests) <= 12
    step = constancy(np.where(days == 5, 10.0, 0.0), np.ones(12), days)
    assert step.differs(1e-3) and step.spread > 1.0


def test_a_trend_is_found_that_scatter_hides():
    """A drift of two sigma over the whole time shows in the trend before it shows in the chi-square."""
    rng = np.random.default_rng(2)
    days = np.linspace(0.0, 100.0, 60)
    t = constancy(0.02 * days + rng.standard_normal(60), np.ones(60), days)
    assert t.p_trend < 1e-3 < t.p
    assert abs(t.slope - 0.02) < 4.0 * t.slope_sigma


def test_a_run_that_cannot_tell_is_left_out():
    """An infinite sigma counts for nothing; one value alone is constant."""
    t = constancy(np.array([1.0, 1e9]), np.array([0.1, np.inf]), np.array([0.0, 1.0]))
    assert t.degrees == 0 and t.p == 1.0 and not t.differs(0.1)


def test_what_one_run_alone_shows_is_told_apart():
    """A calibration of ten within its stated scale but for one run is that run's; what the others show, too, is not."""
    rng = np.random.default_rng(3)
    sigmas = np.full(10, 3e-4)
    gains = 0.003 * np.clip(rng.standard_normal(10), -1.5, 1.5)
    gains -= gains.mean()
    assert one_run_alone(gains, sigmas, 0.0, 0.005) is None
    gains[4] = 0.0141
    found = one_run_alone(gains, sigmas, 0.0, 0.005)
    assert found is not None and found.place == 4
    assert abs(found.others) < 2.0 * found.others_sigma
    assert one_run_alone(gains + 0.005, sigmas, 0.0, 0.005) is None  # the others show it, too
    assert one_run_alone(np.full(10, 1.7), np.ones(10), 0.0, 0.0) is None  # none does by itself, all do together


def test_two_runs_that_show_an_effect_are_not_one():
    """An effect of two runs among ten belongs to neither alone, nor does one that two runs in all could tell."""
    values = np.zeros(10)
    values[[2, 7]] = 5.0
    assert one_run_alone(values, np.ones(10), 0.0, 0.0) is None
    values[7] = np.nan
    found = one_run_alone(values, np.where(np.isnan(values), np.inf, 1.0), 0.0, 0.0)
    assert found is not None and found.place == 2
    assert one_run_alone(np.array([5.0, 0.0]), np.ones(2), 0.0, 0.0) is None
