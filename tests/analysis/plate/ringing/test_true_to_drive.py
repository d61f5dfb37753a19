"""From which gamma a ringing plate is no longer true to its drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.plate.ringing.ball_push import Push
from analysis.plate.ringing.mode_motion import PushedPlate
from analysis.plate.ringing.modes import parts_of_drive, ringing_in_words
from analysis.plate.ringing.regression import PlateMode


def _struck(mass_ratio: float) -> PlateMode:
    """A mode of 8 Hz that a ball strikes harder and harder for eight seconds."""
    hits_s = np.arange(0.05, 8.0, 0.0437)
    push = Push(np.zeros(8000), hits_s, -0.2 * hits_s, 1e-3)
    plate = PushedPlate(push, np.zeros(8000), np.zeros(8000, dtype=np.bool_), 0.1)
    return PlateMode(8.0, 0.05, mass_ratio, np.eye(3), 0.1, 1.0, 1e3, plate)


SPAN_S = np.array([[k, k + 0.9] for k in range(8)], dtype=np.float64)
GAMMA, DRIVE_MPS = np.linspace(0.5, 2.6, 8), np.full(8, 0.05)


def test_the_part_of_a_light_ball_is_in_proportion_to_its_mass() -> None:
    """Half the mass ratio, as a mode or as a factor: half the speed, under the same impacts."""
    whole = parts_of_drive(_struck(0.02), SPAN_S, DRIVE_MPS, np.ones(3))
    assert parts_of_drive(_struck(0.01), SPAN_S, DRIVE_MPS, np.ones(3)) == pytest.approx(0.5 * whole)
    assert parts_of_drive(_struck(0.02), SPAN_S, DRIVE_MPS, np.array([1.0, 1.0, 0.5])) == pytest.approx(0.5 * whole)


def test_the_gamma_is_that_above_which_no_step_is_true() -> None:
    """It is named with cures where the ball is heavy, in steps of any order; a light ball spoils nothing."""
    part = parts_of_drive(_struck(0.01), SPAN_S, DRIVE_MPS, np.ones(3))
    assert part[3] < 0.05 < part[4]
    order = np.array([3, 7, 0, 5, 1, 6, 2, 4])
    words = ringing_in_words(_struck(0.01), GAMMA[order], SPAN_S[order], DRIVE_MPS)
    assert f"from gamma {GAMMA[4]:.3g} on" in words and "with half the ball" in words
    assert "nowhere lastingly above 5 %" in ringing_in_words(_struck(0.001), GAMMA, SPAN_S, DRIVE_MPS)


def test_a_second_mode_is_said_with_what_it_explains_of_the_first_ones_remainder() -> None:
    """One mode is then no longer enough, and the operator reads where the next one lies."""
    second = PlateMode(12.0, 0.03, 0.01, np.eye(3), 0.1, 0.25, 1e3)
    words = ringing_in_words(replace(_struck(0.01), second=second), GAMMA, SPAN_S, DRIVE_MPS)
    assert words.startswith(
        "one mode does not suffice, of the 0.25 m/s^2 that it leaves one of 12 Hz (damping 0.03, 1 %) explains all but"
    )
    assert "rings at 8 Hz under the ball (7.96 Hz with the ball on it" in words and "are left" not in words
    left = replace(_struck(0.01), noise_mps2=0.05, left_hz=11.0)
    assert "0.1 m/s^2 are left where noise is 0.05, most of it at 11 Hz" in ringing_in_words(
        left, GAMMA, SPAN_S, DRIVE_MPS
    )
