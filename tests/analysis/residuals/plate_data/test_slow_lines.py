"""Lines of the plate that are no multiple of the forcing."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.residuals.plate_data.slow_motion import clustered, other_lines_radps
from model.integrator.problem import PlateSteps


def test_a_line_counts_where_several_steps_show_it() -> None:
    """Three steps at 7 Hz make a hint, a lone line at 13 Hz does not."""
    assert clustered(np.array([7.0, 13.0, 7.1, 6.9]), 3) == pytest.approx((7.0,))
    assert clustered(np.zeros(0), 3) == ()


def test_other_lines_are_those_that_do_not_repeat_every_cycle() -> None:
    """Of a forcing tone, its harmonic, the mains and an empty place the mains are left, and the hint is added."""
    turn = 2.0 * np.pi
    plate = PlateSteps(turn * np.array([[25.0, 75.0, 60.0, 41.0]]), np.array([[1, 1, 1, 0j]]), np.array([1 / 25.0]))
    assert other_lines_radps(plate, (7.0,))[0] == pytest.approx(turn * np.array([60.0, 7.0]))
