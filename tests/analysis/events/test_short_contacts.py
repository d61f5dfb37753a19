"""Short contacts: both edges from one RC pulse, with or without an impact in the accelerometer."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.short_contacts import MAX_SHAPE_ERROR, rc_pulse, short_contact

TAU = (0.4, 0.4)
NOISE = 4e-4


def test_pulses_with_an_impact_are_fitted_as_well_as_stated() -> None:
    """Over random short contacts the errors of both edges scatter as stated."""
    rng = np.random.default_rng(7)
    pulls = []
    for _ in range(150):
        close, length = 3.0 + rng.random(), rng.uniform(0.2, 2.5)
        volts = rc_pulse(12, close, length, TAU) + NOISE * rng.standard_normal(12)
        lowest = float(np.argmin(volts))
        fit = short_contact(volts, NOISE, TAU, (lowest - 2.5, lowest), (close + 0.02 * rng.standard_normal(), 0.02))
        assert fit is not None
        pulls.append([(fit[0] - close) / fit[1], (fit[2] - close - length) / fit[3]])
    assert 1.4826 * np.median(np.abs(pulls)) == pytest.approx(1.0, abs=0.25)
    assert np.quantile(np.abs(pulls), 0.98) < 5.0


def test_both_edges_between_the_same_samples_are_not_claimed_to_be_known() -> None:
    """A contact within one interval leaves one number for two unknowns: the uncertainty says so."""
    volts = rc_pulse(12, 3.2, 0.5, TAU)
    fit = short_contact(volts, NOISE, TAU, (1.5, 4.0))
    assert fit is not None
    assert fit[1] > 0.05
    assert abs(fit[0] - 3.2) < 3.0 * fit[1]


def test_a_contact_that_bounces_is_not_taken_for_one_pulse() -> None:
    """Two pulses in the window are refused."""
    volts = rc_pulse(12, 3.2, 0.8, TAU) * rc_pulse(12, 6.1, 1.0, TAU)
    assert short_contact(volts, NOISE, TAU, (2.0, 4.5)) is None


def test_a_pulse_of_another_shape_yields_to_the_accelerometer() -> None:
    """A contact that touched twice, fitted with the slow closing of the average: 0.6 samples early, or in doubt."""
    close, slow = 2.70, (1.2, 0.4)
    volts = np.array([1.0, 1.0, 1.0, 0.475, 0.257, 0.936, 0.994, 1.0, 1.0, 1.0, 1.0, 1.0])
    trusted = short_contact(volts, NOISE, slow, (1.5, 4.0), (close, 0.04))
    doubted = short_contact(volts, MAX_SHAPE_ERROR, slow, (1.5, 4.0), (close, 0.04))
    assert trusted is not None and abs(trusted[0] - close) > 50.0 * trusted[1]
    assert doubted is not None and abs(doubted[0] - close) < 3.0 * doubted[1]
