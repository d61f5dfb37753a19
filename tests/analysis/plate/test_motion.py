"""The plate's motion of the simulated rig: amplitudes, phases, harmonics and slow lines as they were put in."""

from __future__ import annotations

import math

import numpy as np
import pytest

from analysis.flights.scan import plate_of
from daq.recording import open_recording

G = 9.80665


@pytest.mark.parametrize("ratio", [1, 2])
def test_gamma_and_phase_are_those_of_the_drive(make, ratio: int) -> None:
    """Over a ramp with impacts, amplitudes and phases scatter about the truth as stated; the drive agrees."""
    gammas = np.linspace(0.5, 2.4, 8) / ratio
    with open_recording(make(gammas, ratio=ratio).path) as recording:
        plate = plate_of(recording)
    pulls = []
    for gamma, step in zip(gammas, plate.steps, strict=True):
        assert step is not None
        assert step.gamma_drive == pytest.approx(gamma, rel=1e-3)
        for m in step.forcing_multiples:
            z, covariance = step.tone(m)
            truth = 1j * gamma * G * m * m * (2.0 if ratio == 1 else 1.0)
            pulls += [(z - truth).real / np.sqrt(covariance[0, 0]), (z - truth).imag / np.sqrt(covariance[1, 1])]
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.45)
    assert plate.noise_mps2 == pytest.approx(0.03 * G, rel=0.1)
    if ratio == 1:
        assert plate.steps[0].gamma_peak == pytest.approx(2.0 * gammas[0], rel=5e-3)


def test_distortion_and_mains_are_seen_in_the_right_places(make) -> None:
    """A bent amplifier shows as second and third harmonic; a hum at 50 Hz as its own line."""
    effects = {
        "harmonic_distortion": {"second_per_v": 0.03, "third_per_v2": 0.3},
        "mains_hum": {"amplitude_g": 0.1, "frequency_hz": 50.0, "phase_rad": 1.0},
    }
    with open_recording(make([0.45, 0.45], hold=40, effects=effects).path) as recording:
        step = plate_of(recording).steps[0]
    assert step is not None
    volts = 0.45 * 2.0 / 2.0
    second, third = abs(step.tone(2)[0]), abs(step.tone(3)[0])
    assert second == pytest.approx(2.0 * G * 0.03 * volts**2 / 2.0, rel=0.1)
    assert third == pytest.approx(2.0 * G * 0.3 * volts**3 / 4.0, rel=0.1)
    hum = step.acceleration.amplitudes[len(step.multiples) + 0]
    assert abs(hum) == pytest.approx(0.1 * G, rel=0.05)


def test_a_breathing_amplitude_shows_within_the_step(make) -> None:
    """A slow modulation of the drive is followed window by window."""
    effects = {"amplitude_modulation": {"depth": 0.05, "frequency_hz": 1.0}}
    with open_recording(make([0.45], hold=60, effects=effects).path) as recording:
        windows = plate_of(recording).steps[0].windows
    size = np.abs(windows.amplitudes[:, 0])
    ripple = np.abs(np.mean((size / size.mean() - 1.0) * np.exp(-2j * np.pi * windows.time_s))) * 2.0
    assert ripple == pytest.approx(0.05, rel=0.15)


def test_a_slow_resonance_is_reported(make) -> None:
    """A table that swings after impacts shows a line below the forcing; a stiff one shows none."""
    effects = {"table_resonance": {"frequency_hz": 9.0, "damping": 0.02, "mass_ratio": 0.04}}
    with open_recording(make([2.5], hold=40, effects=effects).path) as recording:
        lines = plate_of(recording).steps[0].lines
    assert lines and lines[0].frequency_hz < 25.37 * 0.9
    with open_recording(make([1.0], hold=40).path) as recording:
        assert plate_of(recording).steps[0].lines == ()


def test_mass_loading_shows_between_contact_and_flight(make) -> None:
    """Where the ball loads the table, the tone is smaller in contact than in flight."""
    with open_recording(make([0.75], hold=60, effects={"mass_loading": {"mass_ratio": 0.08}}).path) as recording:
        step = plate_of(recording).steps[0]
    assert step.flight_log_gain is not None
    assert step.flight_log_gain[0] == pytest.approx(math.log(1.08), abs=0.02)
