"""Two clocks: the marker is found, the lag is followed, the map is as good as it says."""

from __future__ import annotations

import numpy as np
import pytest

from daq.clocks.clock_sync import ClockTracker, find_marker, fit_clock, start_marker, window_samples
from daq.files.tables import CLOCK_DTYPE
from tests.fakes.played_time import played_s

RATE = 20000.0
LATENCY = 311.37
NO_GAPS = np.zeros((0, 2), np.int64)


def drive(place: np.ndarray, ratio: int = 1) -> np.ndarray:
    """A ramp of steps of three seconds, faded, at any place between the samples."""
    t = place / RATE
    step = np.floor(t / 3.0)
    w = np.clip((t - 3.0 * step) / 0.2, 0.0, 1.0)
    size = 0.2 + 0.05 * (step - 1 + w * w * (3.0 - 2.0 * w))
    wave = np.sin(2 * np.pi * 25.37 * t) + (ratio**2 * np.sin(2 * np.pi * ratio * 25.37 * t) if ratio > 1 else 0.0)
    return np.where(t >= 0.0, size * wave, 0.0)


def lags(n: int, ppm: float = 80.0) -> tuple[np.ndarray, np.ndarray]:
    """A clock that is off and drifts: place of every frame among the played samples, and its rate less one."""
    t = np.arange(n) / RATE
    rate = 1e-6 * (ppm + t / 60.0 + 0.3 * np.sin(2 * np.pi * t / 37.0))
    return np.arange(n) - LATENCY + np.cumsum(rate), rate


def tracked(
    place: np.ndarray, noise_db: float, ratio: int = 1, guess: float = 0.3, origin: int = 0, skip: slice = slice(0, 0)
) -> ClockTracker:
    """The tracker after hearing the drive at ``place``, frames ``skip`` lost."""
    heard = drive(place, ratio)
    heard += np.std(heard) * 10 ** (-noise_db / 20) * np.random.default_rng(3).standard_normal(heard.size)
    played = drive(np.arange(place.size + 2000.0), ratio)
    tracker = ClockTracker(-LATENCY - origin + guess, origin, 1000, RATE)
    for first in range(0, place.size, 800):
        tracker.played(played[first : first + 800])
        kept = np.setdiff1d(np.arange(first, min(first + 800, place.size)), np.arange(skip.start, skip.stop))
        for run in np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1):
            if run.size:
                tracker.heard(origin + int(run[0]), heard[run])
    return tracker


@pytest.mark.parametrize("ratio", [1, 3])
def test_at_40_db_a_microsecond_and_a_tenth_of_a_ppm(ratio: int) -> None:
    """80 ppm apart and drifting: offset and rate in the middle of each step are that good, and as good as stated."""
    place, rate = lags(int(60 * RATE))
    rows = np.concatenate(tracked(place, 40.0, ratio).readings)
    pulls = (rows["played_sample"] - place[rows["recorded_sample"]]) / rows["uncertainty"]
    assert not rows["jump"].any()
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=0.15)
    at = np.arange(30_000, place.size, 60_000)
    fit = fit_clock(rows, at)
    off, off_rate = fit["played_sample"] - place[at], fit["rate"] - rate[at]
    assert np.sqrt(np.mean(off**2)) / RATE < 1e-6
    assert np.sqrt(np.mean(off_rate**2)) < 0.1e-6
    assert np.sqrt(np.mean((off / fit["uncertainty"]) ** 2)) < 1.5
    assert np.sqrt(np.mean((off_rate / fit["rate_uncertainty"]) ** 2)) < 1.5
    times = np.linspace(2.0, 58.0, 999)
    true = np.interp(times * RATE, np.arange(place.size), place) / RATE
    assert np.sqrt(np.mean((played_s(times, fit, NO_GAPS, RATE) - true) ** 2)) < 1e-6


def test_lost_frames_cost_readings_and_not_the_map() -> None:
    """A hole of 5000 frames: the tracker goes on, and times on the recording's axis jump over it."""
    place, _ = lags(int(20 * RATE))
    hole = slice(150_000, 155_000)
    rows = np.concatenate(tracked(place, 40.0, skip=hole).readings)
    fit = fit_clock(rows, np.arange(30_000, place.size, 60_000))
    recorded = np.array([100_000, 160_000])  # of the frames that were recorded
    times = played_s(recorded / RATE, fit, np.array([[150_000, 5_000]]), RATE)
    np.testing.assert_allclose(times * RATE, place[[100_000, 165_000]], atol=0.03)


def test_the_device_counts_from_anywhere() -> None:
    """A device that has run for days: raw counters are kept as they are, recorded samples count from the first."""
    place, _ = lags(int(6 * RATE))
    rows = np.concatenate(tracked(place, 60.0, origin=10**10).readings)
    assert (rows["device_sample"] - rows["recorded_sample"] == 10**10).all()
    np.testing.assert_allclose(rows["played_sample"], place[rows["recorded_sample"]], atol=0.02)


def test_a_drive_that_is_interrupted_is_marked_as_a_jump() -> None:
    """An output that starves for 12 samples: one reading says so, and the map is right on both sides."""
    place, _ = lags(int(12 * RATE))
    place[120_300:] -= 12.0
    rows = np.concatenate(tracked(place, 40.0).readings)
    jumped = rows["recorded_sample"][rows["jump"] != 0]
    assert 1 <= jumped.size <= 2 and abs(jumped[0] - 120_300) < 2000
    fit = fit_clock(rows, np.array([60_000, 200_000]))
    np.testing.assert_allclose(fit["played_sample"], place[[60_000, 200_000]], atol=0.03)


def test_windows_that_a_busy_machine_broke_do_not_spoil_the_rate() -> None:
    """The output starves piece by piece, falls behind and catches up at once: afterwards the rate is right to a ppm."""
    place, rate = lags(int(12 * RATE))
    rng = np.random.default_rng(5)
    place[1_000:18_000] -= np.linspace(0.0, 15.0, 17_000)
    for at in range(1_000, 18_000, 500):
        place[at : at + 200] += rng.integers(-40, 40)
    rows = np.concatenate(tracked(place, 40.0).readings)
    at = np.array([60_000, 120_000, 230_000])
    np.testing.assert_allclose(fit_clock(rows, at)["rate"], rate[at], rtol=0.0, atol=1e-6)


def test_silence_says_nothing() -> None:
    """Without a drive there are no readings, and a map of nothing is NaN."""
    tracker = ClockTracker(0.0, 0, 1000, RATE)
    tracker.played(np.zeros(5000))
    tracker.heard(0, 1e-3 * np.random.default_rng(0).standard_normal(5000))
    assert tracker.readings == []
    assert np.isnan(fit_clock(np.zeros(0, CLOCK_DTYPE), np.array([100]))["played_sample"][0])


@pytest.mark.parametrize("ppm", [-300.0, 0.0, 300.0])
@pytest.mark.parametrize("begin", [900.0, 2500.25, 7999.5])
def test_the_marker_is_found_to_a_part_of_a_sample(begin: float, ppm: float) -> None:
    """In noise as high as a tenth of it, through a 20 Hz high-pass, on a clock that is off: to 0.2 samples."""
    marker = start_marker(RATE)
    t = np.arange(20_000) * (1.0 + ppm * 1e-6) - begin * (1.0 + ppm * 1e-6)
    heard = np.interp(t, np.arange(marker.size), marker, left=0.0, right=0.0)
    low = np.zeros(heard.size)
    for i in range(1, heard.size):
        low[i] = low[i - 1] + (heard[i] - low[i - 1]) * 2 * np.pi * 20.0 / RATE
    heard += 0.1 * np.random.default_rng(2).standard_normal(heard.size) - low
    middle = 0.5 * marker.size  # where a chirp on another clock is centred
    assert find_marker(heard, marker) == pytest.approx(begin + middle / (1 + ppm * 1e-6) - middle, abs=0.2)


def test_noise_a_tone_and_an_inverted_marker_are_no_marker() -> None:
    """What is not the marker is not taken for it: noise, the forcing itself, and a loop-back with its wires swapped."""
    rng = np.random.default_rng(4)
    marker = start_marker(RATE)
    tone = np.sin(2 * np.pi * 25.37 / RATE * np.arange(20_000))
    swapped = np.concatenate([np.zeros(3000), -marker, np.zeros(3000)]) + 0.01 * rng.standard_normal(6000 + marker.size)
    for heard in (rng.standard_normal(20_000), tone + 1e-3 * rng.standard_normal(20_000), swapped, marker[:100]):
        assert find_marker(heard, marker) is None


def test_the_clock_of_a_slow_drive_is_followed() -> None:
    """At 0.1 Hz a window is long enough that the drive in it fits at one lag only."""
    rng, n = np.random.default_rng(5), 200_000
    played = 0.5 * np.sin(2 * np.pi * 0.1 * np.arange(n) / 2000.0)
    heard = np.concatenate([np.zeros(40), played[:-40]]) + 2e-4 * rng.standard_normal(n)
    tracker = ClockTracker(-40.0, 0, window_samples(2000.0, 0.1), 2000.0)
    for first in range(0, n, 1000):
        tracker.played(played[first : first + 1000])
        tracker.heard(first, heard[first : first + 1000])
        assert tracker.lag(first) == pytest.approx(-40.0, abs=2.0)
    assert len(tracker.readings) > 5
