"""Evidence of several recordings in one table."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import clustered, join

FRICTION = {("coulomb_friction", "mu_up"): 0.1, ("coulomb_friction", "mu_down"): 0.1}
QUIET = (0.22, 0.23, 0.24, 0.25)


def test_joined_recordings_keep_their_own_steps(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Two runs in one table: flights of the second point at its own steps, and predict as they did alone."""
    one, two = (fly_ramp(FRICTION, seed, gammas=QUIET).evidence for seed in (1, 2))
    both = join([one, two])
    assert len(both) == len(one) + len(two)
    assert both.measured.step[len(one)] == len(one.steps) + two.measured.step[0]
    assert set(both.steps.recording) == {0, 1}
    assert len(both.plate) == len(one.plate) + len(two.plate)
    alone, together = ForwardModel(two, {}).residuals(FRICTION), ForwardModel(both, {}).residuals(FRICTION)
    assert together.landing_s[len(one) :] == pytest.approx(alone.landing_s, abs=1e-9, nan_ok=True)
    assert together.plate[len(one.plate) :] == pytest.approx(alone.plate)


def test_a_line_counts_where_several_steps_show_it() -> None:
    """Three steps at 7 Hz make a hint, a lone line at 13 Hz does not."""
    assert clustered(np.array([7.0, 13.0, 7.1, 6.9]), 3) == pytest.approx((7.0,))
    assert clustered(np.zeros(0), 3) == ()
