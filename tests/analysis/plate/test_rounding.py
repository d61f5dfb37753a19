"""What a converter's steps leave in tones: against sines that are rounded, with and without noise."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.plate.rounding import converter_step, rounding_sigma

STEP = 0.05


def tone_errors(noise: float, *, amplitudes: np.ndarray) -> np.ndarray:
    """Errors of both quadratures of rounded sines, incommensurate with the sampling, (n, 2)."""
    rng = np.random.default_rng(3)
    phase = 2.0 * np.pi * 0.0012685 * np.arange(40_000)
    turning = np.exp(-1j * phase)
    out = []
    for amplitude in amplitudes:
        read = amplitude * np.cos(phase + 0.3) + noise * rng.standard_normal(len(phase))
        rounded = STEP * np.round(read / STEP)
        error = 2.0 * np.mean((rounded - amplitude * np.cos(phase + 0.3)) * turning)
        out.append((error * np.exp(-0.3j)).real)
    return np.array(out)


@pytest.mark.parametrize("noise", [0.0, 0.2 * STEP])
def test_rounding_leaves_in_a_tone_what_is_stated(noise: float) -> None:
    """Root mean square over amplitudes, within a third: the error is not random, whatever the number of samples."""
    amplitudes = np.linspace(0.6, 1.2, 60)
    found = float(np.sqrt(np.mean(tone_errors(noise, amplitudes=amplitudes) ** 2)))
    stated = rounding_sigma(0.9, STEP, np.hypot(noise, STEP / np.sqrt(12.0)))
    assert stated / 1.5 < found < 1.5 * stated


def test_noise_of_a_step_leaves_nothing() -> None:
    """Dithered, the error is noise, which the fit knows of already; so is a signal smaller than a step left alone."""
    assert rounding_sigma(0.9, STEP, STEP) < 1e-6 * STEP
    assert rounding_sigma(0.9, 0.0, 0.01) == 0.0
    assert rounding_sigma(0.5 * STEP, STEP, 0.0) == 0.0


def test_the_step_is_read_from_the_values() -> None:
    """Multiples of a step show it, with spikes among them too; values that are all different show none."""
    rng = np.random.default_rng(4)
    read = np.sin(np.arange(4096) / 50.0) + 0.01 * rng.standard_normal(4096)
    spiky = np.where(rng.random(4096) < 0.01, 20.0 * rng.random(4096), read)
    assert converter_step(STEP * np.round(spiky / STEP)) == pytest.approx(STEP)
    assert converter_step(read) == 0.0
    assert converter_step(np.zeros(4096)) == 0.0


def test_codes_are_counted_as_volts_are_sorted() -> None:
    """Codes over the whole range of 16 bits show the step that the same numbers show as floats."""
    codes = np.repeat(np.array([-32768, -32760, -16, -8, 0, 8, 32760], dtype=np.int16), 10)
    assert converter_step(codes) == converter_step(codes.astype(np.float64)) == 8.0
