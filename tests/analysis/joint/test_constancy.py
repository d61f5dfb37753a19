"""Constancy over runs: constants pass, scatter and trends are found."""

import numpy as np

from analysis.joint.constancy import constancy


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
