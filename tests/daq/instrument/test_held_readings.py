"""Readings that stand for several samples."""

from __future__ import annotations

import numpy as np
import pytest

from daq.instrument.held_readings import RHYTHM_FRAME, coarse_step, held_samples, without_rounding, without_stair

RATE_HZ = 20000.0


def volts(noise: float, step: float) -> list[np.ndarray]:
    """Stretches of a rounded sine in noise, at other phases each."""
    rng, t = np.random.default_rng(6), np.arange(6000) / RATE_HZ
    return [np.round((np.sin(159.0 * t + k) + rng.normal(0.0, noise, t.size)) / step) * step for k in range(5)]


@pytest.mark.parametrize("held", [1.54, 2.0, 2.5, 3.125, 6.25, 12.0])
def test_the_samples_of_a_reading_are_counted(held: float) -> None:
    """Also where a sensor's clock does not fit the samples, and equal readings follow one another."""
    last = (np.arange(6000) // held * held).astype(int)
    assert held_samples([x[last] for x in volts(3e-3, 4e-3)]) == pytest.approx(held, rel=2e-3)


@pytest.mark.parametrize(("noise", "step"), [(1e-2, 1e-6), (0.0, 4e-3), (3e-3, 4e-2), (1e-3, 4e-3), (0.0, 0.2)])
def test_rounding_holds_no_readings(noise: float, step: float) -> None:
    """Neighbours that rounding makes equal come without a rhythm."""
    assert held_samples(volts(noise, step)) == 1.0
    assert held_samples([np.zeros(5000)]) == held_samples([np.arange(50.0)]) == held_samples([]) == 1.0


def test_a_channel_that_is_dead_for_a_while_holds_no_readings() -> None:
    """A stretch of which a part stands still, from one sample to nearly all, has no rhythm."""
    for dead in (1, 500, 1500, 2048, 3000, 3600, 4090):
        stretch = np.random.default_rng(8).normal(size=6000)
        stretch[:dead] = 0.0
        assert held_samples([stretch] * 3) == 1.0


@pytest.mark.parametrize("held", [2, 5])
def test_a_stair_becomes_the_line_through_its_readings(held: int) -> None:
    """Within what a running mean takes from a sine; what is not held stays as it is, to the bit."""
    t = np.arange(4000) / RATE_HZ
    smooth = np.sin(159.0 * t)
    stair = smooth[np.arange(4000) // held * held]
    left = stair.copy()
    without_stair(left, 1.0)
    assert np.array_equal(left, stair)
    without_stair(left, float(held))
    inside = slice(5 * held, -5 * held)
    assert np.abs(left - smooth)[inside].max() < 0.1 * np.abs(stair - smooth)[inside].max()


@pytest.mark.parametrize(
    ("noise", "step", "coarse"), [(0.0, 0.1, 0.1), (4e-3, 0.1, 0.1), (0.04, 0.05, 0.0), (0.01, 1e-6, 0.0)]
)
def test_a_rounding_coarser_than_the_noise_is_found(noise: float, step: float, coarse: float) -> None:
    """Then most readings equal the one before; noise of nearly a step, or of many, hides the rounding."""
    assert coarse_step(volts(noise, step)) == pytest.approx(coarse)
    assert coarse_step([np.zeros(5000)]) == coarse_step([]) == 0.0


def test_a_rounded_motion_becomes_smooth_and_an_impact_stays() -> None:
    """Lines between the steps' middles are near the motion; samples that jump by more than a step stay to the bit."""
    t = np.arange(4000) / RATE_HZ
    motion = 30.0 * np.sin(159.0 * t + 0.4)
    rounded = np.round(motion)
    rounded[2000:2010] += [30, -20, 15, -9, 7, -5, 4, -3, 3, -2]
    smooth = rounded.copy()
    without_rounding(smooth, 1.0)
    np.testing.assert_array_equal(smooth[2000:2009], rounded[2000:2009])
    away = np.abs(np.arange(4000) - 2005) > 60
    assert np.std((smooth - motion)[away]) < 0.5 * np.std((rounded - motion)[away])
    assert np.abs(np.diff(smooth))[away[1:] & away[:-1]].max() < 0.5


def test_new_readings_that_come_only_for_a_while_have_no_rhythm() -> None:
    """A channel that moves in the middle of the samples looked at, and stands before and after, is not held."""
    place = np.arange(RHYTHM_FRAME + 1)
    moves = np.random.default_rng(1).random(place.size) < np.where(abs(place - RHYTHM_FRAME / 2) < 1000, 0.5, 0.0)
    assert held_samples([np.cumsum(moves)]) == 1.0
