"""Weights of events: what a step errs by together is no scatter of its events."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.residuals.noise.noise_model import excess_noise
from analysis.residuals.noise.whitening import StepBlocks
from analysis.thresholds import LEAST_EXCESS_S

STEPS, EACH, EDGE_S, TONE_S, PERIOD_S = 20, 30, 3e-7, 3e-6, 0.04


def blocks(scatter_s: float, seed: int) -> StepBlocks:
    """Landings of twenty steps, each with an error of its own, one of its step, and a scatter that is not stated."""
    rng, n = np.random.default_rng(seed), STEPS * EACH
    together = np.repeat(0.5 * TONE_S * rng.standard_normal(STEPS), EACH)
    bare = together + np.hypot(EDGE_S, scatter_s) * rng.standard_normal(n)
    bounds = np.arange(0, n + 1, EACH)
    ones = np.ones(n)
    return StepBlocks(bare, EDGE_S * ones, TONE_S * ones[:, None], ones < 0.0, PERIOD_S * ones, bounds)


@pytest.mark.parametrize("seed", range(3))
def test_errors_that_a_step_shares_leave_no_excess(seed: int) -> None:
    """Events miss by what their step's tones may err: the likeliest excess is the least, whatever the guess was."""
    found = blocks(0.0, seed).likeliest((LEAST_EXCESS_S, 1.5e-6), (False, False))
    assert found[1] < 1.3 * LEAST_EXCESS_S


@pytest.mark.parametrize("seed", range(3))
def test_a_scatter_of_its_own_is_found_below_a_larger_shared_error(seed: int) -> None:
    """A scatter of 1.2 microseconds under shared errors of three, which a look at single events cannot see."""
    made = blocks(1.2e-6, seed)
    alone, _ = excess_noise(made.bare, np.hypot(EDGE_S, TONE_S) * np.ones(len(made.bare)), made.period_s)
    assert alone == LEAST_EXCESS_S
    found = made.likeliest((LEAST_EXCESS_S, alone), (False, False))[1]
    assert 0.9e-6 < found < 1.3e-6  # the scale of Student's t, 0.87 of a normal deviation


def test_events_far_beyond_shared_errors_keep_soft_weights() -> None:
    """Where more is missing than tones may err by, the first guess of the excess stays: sharp weights lead nowhere."""
    assert blocks(0.0, 0).likeliest((LEAST_EXCESS_S, 1e-4), (False, True))[1] == 1e-4
