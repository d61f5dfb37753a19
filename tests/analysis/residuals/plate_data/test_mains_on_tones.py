"""Mains on a driven tone, from made amplitudes of the plate and of its drive."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from analysis.residuals.plate_data.mains_on_tones import mains_on_tones

RATE_HZ, FORCING_HZ, MAINS_HZ, GAIN = 20e3, 25.01, 50.0 - 0.013, 1.4 * np.exp(0.2j)
LEVELS = np.array([0.4, 1.5, 0.9, 1.2, 0.3, 0.7, 1.4, 0.6, 1.0, 0.5])


def _steps(mains_mps2: float, forcing: tuple[int, ...] = (1, 2)) -> tuple[list[SimpleNamespace], np.ndarray]:
    """Steps of 1.2 s in which the plate follows its drive, and what each shows of its second tone, over its motion."""
    rng = np.random.default_rng(4)
    steps, shown = [], []
    for i, level in enumerate(LEVELS):
        first, last = int(1.2 * i * RATE_HZ), int((1.2 * i + 0.9) * RATE_HZ)
        middle_s = 0.5 * (first + last) / RATE_HZ
        drive = 20.0 * level * np.array([0.25, 1.0]) * np.exp(1j * rng.uniform(0.0, 6.3, 2))
        mains = mains_mps2 * np.exp(1j + 2j * np.pi * (MAINS_HZ - 2.0 * FORCING_HZ) * middle_s)
        noise = 0.004 * (rng.standard_normal(2) + 1j * rng.standard_normal(2))
        seen = SimpleNamespace(
            amplitudes=GAIN * drive + [0.0, mains] + noise, frequencies_hz=FORCING_HZ * np.arange(1, 3)
        )
        steps.append(SimpleNamespace(
            forcing_multiples=forcing, multiples=(1, 2), frequency_hz=FORCING_HZ, first_sample=first, last_sample=last,
            drive=SimpleNamespace(amplitudes=drive), acceleration=seen,
        ))  # fmt: skip
        shown.append(1.0 + mains / (GAIN * drive[1]))
    return steps, np.array(shown)


def test_mains_on_a_driven_tone_are_told_from_its_drive() -> None:
    """Their part of each step's reading is right to noise though their own frequency was never measured."""
    steps, shown = _steps(0.6)
    said = mains_on_tones(steps, RATE_HZ)  # type: ignore[arg-type]
    assert list(said) == [(2, 50.0)]
    assert 1.0 + 0.6 * said[2, 50.0] == pytest.approx(shown, abs=3e-3)


@pytest.mark.parametrize(("mains_mps2", "forcing"), [(0.0, (1, 2)), (0.6, (1,))])
def test_noise_is_no_mains_and_an_undriven_tone_none_on_a_driven(mains_mps2: float, forcing: tuple[int, ...]) -> None:
    """Where the plate follows its drive, and where the second harmonic is not driven, nothing is taken from a tone."""
    assert not mains_on_tones(_steps(mains_mps2, forcing)[0], RATE_HZ)  # type: ignore[arg-type]
