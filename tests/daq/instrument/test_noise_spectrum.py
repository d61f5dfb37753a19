"""Noise as a spectrum: density, bandwidth, size, and what makes it white."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, freqz, lfilter

from daq.instrument.channel_limits import NoiseSpectrum, measure_noise

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


def test_white_noise_is_known_by_its_standard_deviation() -> None:
    """The spectrum of white noise gives it back, and its autocovariance is that of single samples."""
    noise = NoiseSpectrum.white(0.003, RATE_HZ)
    assert noise.rms_v == pytest.approx(0.003)
    assert noise.autocovariance(3) == pytest.approx([9e-6, 0.0, 0.0], abs=1e-9)


def spectrum(x: np.ndarray, frame: int = 256) -> NoiseSpectrum:
    """Of all of it."""
    found = measure_noise([x], [np.ones(x.size, dtype=bool)], RATE_HZ, frame)
    assert found is not None
    return found


@pytest.mark.parametrize(("corner_hz", "poles"), [(None, 0), (5000.0, 2), (2000.0, 1), (3000.0, 4)])
def test_density_and_bandwidth(corner_hz: float | None, poles: int) -> None:
    """Density to 5 % and the corner of a low-pass to 8 % come back; noise that is flat has no bandwidth."""
    x = np.random.default_rng(1).normal(0.0, 0.01, 200_000)
    if corner_hz is not None:
        x = lfilter(*butter(poles, corner_hz / (RATE_HZ / 2)), x)
    found = spectrum(x)
    assert found.rms_v == pytest.approx(float(x.std()), rel=0.05)
    assert np.sqrt(found.slow_v2phz) == pytest.approx(0.01 / np.sqrt(RATE_HZ / 2), rel=0.05)
    assert (found.bandwidth_hz is None) == (corner_hz is None)
    assert found.bandwidth_hz is None or found.bandwidth_hz == pytest.approx(corner_hz, rel=0.08)


def test_noise_that_falls_like_one_over_f_is_behind_no_filter() -> None:
    """1/f noise has no bandwidth."""
    hz = np.fft.rfftfreq(200_000, 1.0 / RATE_HZ)
    hz[0] = hz[1]
    x = np.fft.irfft(np.fft.rfft(np.random.default_rng(2).standard_normal(200_000)) / np.sqrt(hz))
    assert spectrum(x).bandwidth_hz is None


def test_impacts_in_a_few_frames_do_not_count() -> None:
    """A shock in each tenth frame leaves the density to 10 %."""
    x = np.random.default_rng(3).normal(0.0, 0.01, 100_000)
    x[::2560] += 5.0
    assert np.sqrt(spectrum(x).slow_v2phz) == pytest.approx(0.01 / np.sqrt(RATE_HZ / 2), rel=0.1)
