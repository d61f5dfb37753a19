"""The accelerometer's noise as a spectrum, and a detector's threshold from its own output."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, freqz, lfilter

from analysis.events.accelerometer_noise import FALSE_PER_HOUR, NoiseSpectrum, measure_noise, scale_and_threshold

RATE_HZ = 20000.0
FILTER = butter(2, 3000.0, fs=RATE_HZ)


def behind_a_low_pass(n: int, seed: int = 1) -> np.ndarray:
    """Noise of 3 mV before a low-pass of 3 kHz, two poles."""
    return np.asarray(0.003 * lfilter(*FILTER, np.random.default_rng(seed).standard_normal(n)))


def test_noise_behind_a_low_pass_is_measured_between_impacts() -> None:
    """Thirty impacts a second, ten times the noise: the density is the filter's, within a tenth where it passes."""
    volts = behind_a_low_pass(1 << 18)
    for at in range(500, volts.size - 400, 667):
        volts[at : at + 60] += 0.03 * np.exp(-np.arange(60) / 20.0) * np.sin(np.arange(60) / 2.0)
    noise = measure_noise([volts], [np.ones(volts.size, dtype=bool)], RATE_HZ)
    assert noise is not None
    passed = (noise.frequencies_hz > 300.0) & (noise.frequencies_hz < 6000.0)
    gain = np.abs(freqz(*FILTER, noise.frequencies_hz[passed], fs=RATE_HZ)[1]) ** 2
    assert noise.density_v2phz[passed] == pytest.approx(2.0 * 0.003**2 / RATE_HZ * gain, rel=0.1)
    assert noise.rms_v == pytest.approx(float(np.std(behind_a_low_pass(1 << 18))), rel=0.05)


def test_the_whitener_makes_coloured_noise_white() -> None:
    """Snippets of noise whose neighbours are alike, whitened: unit variance, and no sample follows from the others."""
    draw = 0.003 * np.random.default_rng(1).standard_normal(48 * 20000 + 1)
    snippets = (draw[1:] + 0.6 * draw[:-1]).reshape(-1, 48)
    noise = measure_noise([snippets.ravel()], [np.ones(snippets.size, dtype=bool)], RATE_HZ)
    assert noise is not None
    white = snippets @ noise.whitener(48).T
    assert white.T @ white / len(white) == pytest.approx(np.eye(48), abs=0.05)
    assert np.std(noise.innovations(snippets.ravel())) == pytest.approx(1.0, rel=0.02)


def test_too_few_samples_or_a_channel_that_stands_still_have_no_spectrum() -> None:
    """Nothing is made up where nothing can be measured."""
    for volts in (behind_a_low_pass(300), np.zeros(20000)):
        assert measure_noise([volts], [np.ones(volts.size, dtype=bool)], RATE_HZ) is None


def test_a_threshold_comes_from_the_output_of_the_detector() -> None:
    """Normal output: six sigmas, whatever its size. A heavier tail: higher, and passed no more often than stated."""
    rng = np.random.default_rng(2)
    scale, threshold = scale_and_threshold(1.7 * rng.standard_normal(400_000), RATE_HZ)
    assert scale == pytest.approx(1.7, rel=0.01)
    assert threshold == pytest.approx(6.2, abs=0.3)

    def bursts(n: int) -> np.ndarray:
        return rng.standard_normal(n) * np.where(rng.random(n) < 0.1, 2.0, 1.0)

    scale, threshold = scale_and_threshold(bursts(400_000), RATE_HZ)
    assert threshold > 7.0
    hours = 20_000_000 / RATE_HZ / 3600.0
    assert np.count_nonzero(bursts(20_000_000) > threshold * scale) <= 3 + hours * FALSE_PER_HOUR


def test_white_noise_is_known_by_its_standard_deviation() -> None:
    """The spectrum of white noise gives it back, and its autocovariance is that of single samples."""
    noise = NoiseSpectrum.white(0.003, RATE_HZ)
    assert noise.rms_v == pytest.approx(0.003)
    assert noise.autocovariance(3) == pytest.approx([9e-6, 0.0, 0.0], abs=1e-9)
