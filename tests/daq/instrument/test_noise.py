"""Noise of an accelerometer: density, bandwidth, and the traces of linear interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter, resample_poly

from daq.instrument.noise import described, interpolation_hz, spectrum, window_samples
from kernels.arrays import Floats

RATE_HZ = 20000.0


def windows(x: Floats) -> list[Floats]:
    """Noise cut into windows."""
    n = window_samples(RATE_HZ)
    return [x[i : i + n] for i in range(0, len(x) - n, n)]


@pytest.mark.parametrize(("corner_hz", "poles"), [(None, 0), (5000.0, 2), (2000.0, 1), (3000.0, 4)])
def test_density_and_bandwidth(corner_hz: float | None, poles: int) -> None:
    """Density to 5 % and the corner of a low-pass to 8 % come back; noise that is flat has no bandwidth."""
    x = np.random.default_rng(1).normal(0.0, 0.01, 200_000)
    if corner_hz is not None:
        x = lfilter(*butter(poles, corner_hz / (RATE_HZ / 2)), x)
    found = spectrum(windows(x), RATE_HZ)
    assert found is not None
    rms, density, bandwidth_hz = described(*found)
    assert rms == pytest.approx(float(x.std()), rel=0.05)
    assert density == pytest.approx(0.01 / np.sqrt(RATE_HZ / 2), rel=0.05)
    assert (bandwidth_hz is None) == (corner_hz is None)
    assert bandwidth_hz is None or bandwidth_hz == pytest.approx(corner_hz, rel=0.08)


def test_noise_that_falls_like_one_over_f_is_behind_no_filter() -> None:
    """1/f noise has no bandwidth."""
    hz = np.fft.rfftfreq(200_000, 1.0 / RATE_HZ)
    hz[0] = hz[1]
    x = np.fft.irfft(np.fft.rfft(np.random.default_rng(2).standard_normal(200_000)) / np.sqrt(hz))
    found = spectrum(windows(x), RATE_HZ)
    assert found is not None and described(*found)[2] is None


def test_impacts_in_a_few_windows_do_not_count() -> None:
    """A shock in each tenth window leaves the density to 10 %; fewer than eight windows tell nothing."""
    x = np.random.default_rng(3).normal(0.0, 0.01, 100_000)
    x[:: 10 * window_samples(RATE_HZ)] += 5.0
    found = spectrum(windows(x), RATE_HZ)
    assert found is not None
    assert described(*found)[1] == pytest.approx(0.01 / np.sqrt(RATE_HZ / 2), rel=0.1)
    assert spectrum(windows(x)[:5], RATE_HZ) is None


@pytest.mark.parametrize(
    ("rate_hz", "lines", "beat_hz"),
    [(44100, True, 20000), (18000, True, 2000), (48000, True, 20000), (48000, False, None), (20000, False, None)],
)
def test_linear_interpolation_shows_in_the_noise(rate_hz: int, lines: bool, beat_hz: float | None) -> None:
    """Files brought to another rate by straight lines are known by the beat of the rates; by a good filter, or not
    brought to another rate at all, they are not."""
    rng, channels = np.random.default_rng(4), []
    t = np.arange(60_000) / RATE_HZ
    motion = np.sin(2 * np.pi * 25.37 * t)
    for _ in range(2):
        x = motion + rng.normal(0.0, 0.01, len(t))
        if lines:
            x = np.interp(np.arange(0.0, t[-1], 1.0 / rate_hz), t, x)
        elif rate_hz != RATE_HZ:
            x = resample_poly(x, 12, 5, window=("kaiser", 14.0))[200:-200]
        channels.append([x])
    found = interpolation_hz(channels, float(rate_hz))
    assert (found is None) == (beat_hz is None)
    assert found is None or found == pytest.approx(beat_hz, abs=8.0)
    assert interpolation_hz(channels[:1], float(rate_hz)) is None  # one witness is none
