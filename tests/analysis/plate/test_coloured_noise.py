"""Noise that rises towards low frequencies, and how uncertain it makes a tone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.flights.scan import plate_of
from daq.files.tables import Block
from daq.recording import Recording, RecordingWriter, open_recording

GAMMAS = np.linspace(0.3, 0.8, 12)  # the ball never leaves the plate
RMS_G = 0.03


def noisier(source: Recording, path: Path, volts: np.ndarray) -> Path:
    """The same recording with volts added to its accelerometer."""
    codes = np.column_stack([source.codes(name) for name in source.channels])
    at = source.channels.index("accelerometer")
    codes[:, at] += np.rint(volts / source.scale("accelerometer")[0]).astype(codes.dtype)
    with RecordingWriter(
        path, source.setup, profile_text="", channels=source.channels, backend="test", simulated=True
    ) as writer:
        writer.append(Block(0, codes, lost_before=0))
        for step in source.steps:
            writer.mark_step(step)
    return path


def one_over_f(n: int, rms: float) -> np.ndarray:
    """Noise whose power falls as one over the frequency."""
    spectrum = np.fft.rfft(np.random.default_rng(5).standard_normal(n))
    noise = np.fft.irfft(spectrum / np.sqrt(np.maximum(np.arange(len(spectrum)), 1.0)), n)
    return np.asarray(rms * noise / noise.std())


@pytest.mark.parametrize("ratio", [1, 2])
def test_coloured_noise_is_in_the_uncertainty_of_the_tones(make, tmp_path: Path, ratio: int) -> None:
    """What 1/f noise changes in a tone is as large as its uncertainty says, not several times that of white noise."""
    with open_recording(make(GAMMAS / ratio**2, ratio=ratio, hold=20).path) as source:
        white = plate_of(source)
        volts = one_over_f(source.n_samples, RMS_G * 9.80665 * abs(source.setup.channels.accelerometer.volts_per_mps2))
        path = noisier(source, tmp_path / "noisier.h5", volts)
    with open_recording(path) as recording:
        coloured = plate_of(recording)
    off = []
    for quiet, loud in zip(white.steps, coloured.steps, strict=True):
        assert quiet is not None and loud is not None
        assert loud.acceleration.amplitude_sigma()[0] > 1.5 * quiet.acceleration.amplitude_sigma()[0]
        change, sigma = loud.tone(1)[0] - quiet.tone(1)[0], loud.acceleration.amplitude_sigma()[0]
        off += [change.real / sigma, change.imag / sigma]
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.4)  # 24 numbers: 0.14 each way, and the colour


def test_white_noise_and_an_amplitude_modulation_change_nothing(make) -> None:
    """Uncertainties stay what the residuals' rms makes them, a modulated amplitude or not."""
    swings = {"amplitude_modulation": {"depth": 0.02, "frequency_hz": 3.0}}
    for effects in ({}, swings):
        with open_recording(make(GAMMAS, hold=20, effects=effects).path) as recording:
            for step in plate_of(recording).steps:
                assert step is not None
                expected = step.acceleration.rms * np.sqrt(2.0 / step.acceleration.n)
                assert step.acceleration.amplitude_sigma()[0] == pytest.approx(expected, rel=0.1)
