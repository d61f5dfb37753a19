"""Noise that rises towards low frequencies, and how uncertain it makes a tone; rounding without dither."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.flights.scan import plate_of
from analysis.plate.ringing.mode_motion import without_ringing
from analysis.plate.tone_noise import converter_step, rounding_sigma
from daq.files.tables import Block
from daq.recording import Recording, open_recording
from daq.recording.writer import RecordingWriter

GAMMAS = np.linspace(0.3, 0.8, 12)  # the ball never leaves the plate
RMS_G = 0.03


def noisier(source: Recording, path: Path, volts: np.ndarray) -> Path:
    """The same recording with volts added to its accelerometer."""
    codes = source.codes("accelerometer")
    return with_codes(source, path, codes + np.rint(volts / source.scale("accelerometer")[0]).astype(codes.dtype))


def with_codes(source: Recording, path: Path, changed: np.ndarray, channel: str = "accelerometer") -> Path:
    """The same recording with other codes of a channel."""
    codes = np.column_stack([source.codes(name) for name in source.channels])
    codes[:, source.channels.index(channel)] = changed
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


def test_a_known_mode_is_no_noise_in_a_tone(make) -> None:
    """A residual swollen tenfold by a mode: what stays is the noise without it, and a two-hundredth of its power."""
    with open_recording(make(GAMMAS, hold=20).path) as recording:
        step = plate_of(recording).steps[0]
    assert step is not None
    fit = step.acceleration
    ringing = replace(step, acceleration=replace(fit, rms=10.0 * fit.rms, covariance=100.0 * fit.covariance))
    known = without_ringing(ringing, fit.rms).acceleration
    assert known.rms == pytest.approx(np.sqrt(1.0 + 99.0 / 200.0) * fit.rms)
    assert known.amplitude_sigma() == pytest.approx(known.rms / fit.rms * fit.amplitude_sigma())
    assert without_ringing(step, 2.0 * fit.rms) is step


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


def test_rounding_makes_no_difference_of_contact_and_flight(make, tmp_path: Path) -> None:
    """A coarse converter's error of the tones in contact and in flight is in the uncertainty of their difference."""
    with open_recording(make(np.linspace(1.05, 1.3, 16), hold=20, rig={"accelerometer_noise_g": 2e-3}).path) as source:
        coarse = 32  # 0.1 g
        path = with_codes(source, tmp_path / "coarse.h5", coarse * np.rint(source.codes("accelerometer") / coarse))
    with open_recording(path) as recording:
        found = [s.flight_log_gain for s in plate_of(recording).steps if s is not None]
    off = np.array([change / sigma for change, sigma in filter(None, found)])
    assert len(off) > 5
    assert np.sqrt(np.mean(off**2)) < 1.5


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
    assert converter_step(np.tile(np.sin(2.0 * np.pi * np.arange(400) / 400.0), 10)) == 0.0  # a drive without noise


def test_rounding_of_the_drive_is_in_the_uncertainty_of_its_tones(make, tmp_path: Path) -> None:
    """A monitor of 8 bits: its tones are off by more than their noise, and by as much as their uncertainty says."""
    with open_recording(make(GAMMAS, hold=20).path) as source:
        fine = plate_of(source)
        coarse = 0.04 / abs(source.scale("drive")[0])
        path = with_codes(source, tmp_path / "coarse.h5", coarse * np.rint(source.codes("drive") / coarse), "drive")
    off, wider = [], []
    with open_recording(path) as recording:
        for step, exact in zip(plate_of(recording).steps, fine.steps, strict=True):
            assert step is not None and step.drive is not None and exact is not None and exact.drive is not None
            error, sigma = step.drive.amplitudes[0] - exact.drive.amplitudes[0], step.drive.amplitude_sigma()[0]
            off += [error.real / sigma, error.imag / sigma]
            wider.append(sigma / exact.drive.amplitude_sigma()[0])
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.5)
    assert np.median(wider) > 3.0


def test_codes_are_counted_as_volts_are_sorted() -> None:
    """Codes over the whole range of 16 bits show the step that the same numbers show as floats."""
    codes = np.repeat(np.array([-32768, -32760, -16, -8, 0, 8, 32760], dtype=np.int16), 10)
    assert converter_step(codes) == converter_step(codes.astype(np.float64)) == 8.0
