"""Mains lines near the forcing: followed to their own frequency, and taken for nothing else."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from analysis.flights.scan import plate_of
from analysis.plate.mains_lines import (
    BIN_S,
    PRIOR_SIGMA_HZ,
    is_absent,
    noise_near,
    refined_line,
    strongest_hz,
    unmeasured_line,
)
from analysis.residuals.plate_data.plate_observables import HUM, SECOND, THIRD, plate_data, share
from daq.lock_in import ToneFit, fit_tones
from daq.recording import open_recording

G = 9.80665
RATE_HZ = 1000.0


def test_a_hum_off_its_nominal_frequency_spoils_no_tone(make) -> None:
    """At 49.95 Hz, three quarters of a hertz from the second tone, the hum has its size and the tones their own."""
    gammas = np.linspace(0.3, 1.3, 6)
    hum = {"amplitude_g": 0.09, "frequency_hz": 49.95, "phase_rad": 4.0}
    with open_recording(make(gammas, ratio=2, hold=20, effects={"mains_hum": hum}).path) as recording:
        plate = plate_of(recording)
    pulls = []
    for gamma, step in zip(gammas, plate.steps, strict=True):
        assert step is not None
        line = len(step.multiples)
        assert step.acceleration.frequencies_hz[line] == pytest.approx(49.95, abs=0.02)
        assert abs(step.acceleration.amplitudes[line]) == pytest.approx(0.09 * G, rel=0.03)
        for m in step.forcing_multiples:
            z, covariance = step.tone(m)
            truth = 1j * gamma * G * m * m
            pulls += [(z - truth).real / np.sqrt(covariance[0, 0]), (z - truth).imag / np.sqrt(covariance[1, 1])]
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_multiples_of_the_mains_are_fitted_with_it(make) -> None:
    """Odd harmonics on the accelerometer's cable: each has its size, and no more is left than without."""
    gammas = np.linspace(0.3, 1.3, 6)
    rms = {}
    for volts in (0.0, 0.02):
        with open_recording(make(gammas, hold=20, rig={"mains_v": volts, "mains_odd": 1.0}).path) as recording:
            steps = [step for step in plate_of(recording).steps if step is not None]
            scale = recording.setup.channels.accelerometer.volts_per_mps2
        rms[volts] = np.median([step.acceleration.rms for step in steps])
        found = {k: [s for s in steps if np.abs(s.acceleration.frequencies_hz - 50.0 * k).min() < 0.1] for k in (3, 5)}
        for k, with_it in found.items():
            assert len(with_it) == (len(steps) if volts else 0)
            for step in with_it:
                row = int(np.argmin(np.abs(step.acceleration.frequencies_hz - 50.0 * k)))
                assert abs(step.acceleration.amplitudes[row]) == pytest.approx(abs(volts / k / scale), rel=0.1)
    assert rms[0.02] < 1.1 * rms[0.0]


def test_mains_on_an_undriven_harmonic_are_known_as_what_the_cable_picks_up(make) -> None:
    """A forcing of 25 Hz, whose second multiple is the mains: their multiples are fitted, and a pickup explains it."""
    gammas = np.linspace(0.4, 1.3, 6)
    with open_recording(make(gammas, hold=20, frequency_hz=25.0, rig={"mains_v": 0.01, "mains_odd": 1.0}).path) as run:
        steps = [step for step in plate_of(run).steps if step is not None]
        data, _ = plate_data(steps, run.setup)
    for step in steps:
        row = int(np.argmin(np.abs(step.acceleration.frequencies_hz - 150.0)))
        assert step.acceleration.frequencies_hz[row] == 150.0
        assert abs(step.acceleration.amplitudes[row]) == pytest.approx(0.1 * G / 3.0, rel=0.1)
    second = data.rows_of(SECOND)
    explained = share(data, "mains_pickup", {"amplitude_mps2": 0.1 * G})[second]
    assert data.value[second] == pytest.approx(explained, rel=0.05)
    assert not data.rows_of(HUM).size  # 60 Hz, where nothing is, would deny it


def test_a_harmonic_of_the_forcing_is_not_the_mains_where_another_line_shows_them(make) -> None:
    """A bent drive of 20 Hz makes 60 Hz, much more than the cable's 50 Hz: these are the mains all the same."""
    bent, rig = {"harmonic_distortion": {"third_per_v2": 0.1}}, {"mains_v": 3e-4}
    gammas = np.linspace(0.4, 1.3, 6)
    with open_recording(make(gammas, hold=20, frequency_hz=20.0, effects=bent, rig=rig).path) as run:
        steps = [step for step in plate_of(run).steps if step is not None]
        data, _ = plate_data(steps, run.setup)
    hum, third = data.rows_of(HUM), data.rows_of(THIRD)
    assert len(hum) == len(steps)
    assert data.omega_radps[hum] / (2.0 * np.pi) == pytest.approx(50.0, abs=0.2)
    shared = share(data, "mains_pickup", {"amplitude_mps2": 0.003 * G})
    assert np.mean(data.value[hum]) == pytest.approx(np.mean(shared[hum]), rel=0.2)
    assert not shared[third].any()


def _long(hz: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    time_s = np.arange(40000) / RATE_HZ
    noise = np.random.default_rng(5).standard_normal(time_s.size)
    return time_s, size * np.cos(2 * np.pi * hz * time_s + 1.0) + np.cos(2 * np.pi * 25.37 * time_s) + noise


def _fit_at(x: np.ndarray):
    def at(hz: float) -> ToneFit:
        return fit_tones(x, 0, RATE_HZ, [25.37, hz])

    return at


@pytest.mark.parametrize("hz", [49.8, 49.93, 50.0, 50.21])
def test_a_long_step_finds_a_line_many_turns_off(hz: float) -> None:
    """Over 40 s a line 0.2 Hz off is eight turns away; it is found to a few millihertz, and known to as much."""
    time_s, x = _long(hz, 0.5)
    demodulated = (x - np.cos(2 * np.pi * 25.37 * time_s)) * np.exp(-2j * np.pi * 50.0 * time_s)
    sums = demodulated.reshape(-1, round(BIN_S * RATE_HZ)).sum(axis=1)
    begin_hz, _ = strongest_hz(sums, unmeasured_line(50.0), 40.0)
    line = refined_line(unmeasured_line(50.0), 1, _fit_at(x), begin_hz, np.array([25.37]), 40.0)
    assert line.slopes is not None
    assert abs(line.hz - hz) < 4.0 * line.sigma_hz < 2e-3


def test_noise_moves_no_line() -> None:
    """Where nothing stands out, a line stays where it was and nothing is known of it."""
    time_s, x = _long(50.0, 0.0)
    demodulated = (x - np.cos(2 * np.pi * 25.37 * time_s)) * np.exp(-2j * np.pi * 50.0 * time_s)
    sums = demodulated.reshape(-1, round(BIN_S * RATE_HZ)).sum(axis=1)
    begin_hz, _ = strongest_hz(sums, unmeasured_line(50.0), 40.0)
    line = refined_line(unmeasured_line(50.0), 1, _fit_at(x), begin_hz, np.array([25.37]), 40.0)
    assert line == unmeasured_line(50.0)


@pytest.mark.parametrize("line", [0.0, 0.5])
def test_noise_near_a_line_is_not_that_of_the_whole_band(line: float) -> None:
    """Noise of 9 units up to 100 Hz, of 1 above: near 50 Hz 3.5 times white noise, with a line or without."""
    rng, n = np.random.default_rng(6), 60_000
    spectrum = np.fft.rfft(rng.standard_normal(n))
    spectrum[: n // 10] *= 3.0
    x = np.fft.irfft(spectrum, n)
    near = noise_near(x, np.array([0.02537, 0.05]), 1, RATE_HZ)
    assert near[0, 0] / near[0, 1] == pytest.approx(9.0 / (0.2 * 9.0 + 0.8), rel=0.1)
    found = unmeasured_line(50.0).with_noise(near[0])
    assert found.later(9.0).noise == pytest.approx(1.86, rel=0.05)
    x += line * np.cos(2 * np.pi * 50.0 / RATE_HZ * np.arange(n))
    moved = refined_line(found, 1, _fit_at(x), 50.0, np.array([25.37]), 60.0)
    assert (moved.slopes is not None) == (line > 0.0)


def test_noise_that_rises_towards_low_frequencies_shows_no_mains(make) -> None:
    """1/f noise of 2 mV an octave: at 50 and 60 Hz steps scatter as their uncertainties say, no line is followed."""
    with open_recording(make(np.linspace(0.3, 1.3, 20), hold=20, rig={"flicker_v": 2e-3}).path) as recording:
        steps = [step for step in plate_of(recording).steps if step is not None]
    pulls = [
        np.abs(s.acceleration.amplitudes / s.acceleration.amplitude_sigma())[len(s.multiples) :] ** 2 for s in steps
    ]
    assert {len(pull) for pull in pulls} == {2}
    assert 0.6 < 0.5 * np.mean(pulls) < 1.3


def _with_tones(x: np.ndarray, hz: float) -> ToneFit:
    return fit_tones(x, 0, RATE_HZ, [25.37, 50.74, hz])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("length_s", [3.0, 12.0])
def test_no_line_that_could_be_measured_is_called_absent(length_s: float, seed: int) -> None:
    """Lines of all sizes anywhere within reach: what is called absent moves no line, and noise is called so."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(length_s * RATE_HZ)) / RATE_HZ
    prior, called = unmeasured_line(50.0), []
    for size in (0.0, *np.geomspace(0.02, 1.0, 12)):
        hz = 50.0 + rng.uniform(-prior.reach_hz, prior.reach_hz)
        x = size * np.cos(2 * np.pi * hz * time_s + rng.uniform(0, 6)) + np.cos(2 * np.pi * 25.37 * time_s)
        x += rng.standard_normal(time_s.size)
        fit = fit_tones(x, 0, RATE_HZ, [25.37, 50.74, 50.0])
        others = (fit.amplitudes[:2, None] * np.exp(2j * np.pi * fit.frequencies_hz[:2, None] * time_s)).real.sum(
            axis=0
        )
        turned = (x - fit.offset - others) * np.exp(-2j * np.pi * 50.0 * time_s)
        sums = turned.reshape(-1, round(BIN_S * RATE_HZ)).sum(axis=1)
        begin_hz, _ = strongest_hz(sums, prior, length_s)
        fit_at = partial(_with_tones, x)
        line = refined_line(prior, 2, fit_at, begin_hz, fit.frequencies_hz[:2], length_s)
        called.append(is_absent(fit, 2, prior, sums, length_s))
        assert not called[-1] or line == prior
    assert called[0]
    assert not called[-1]


def test_a_line_keeps_away_from_the_forcing() -> None:
    """What stands at a harmonic of the forcing is no mains line, however near 50 Hz it is."""
    x = np.cos(2 * np.pi * 50.1 * np.arange(2000) / RATE_HZ)
    x += 0.01 * np.random.default_rng(1).standard_normal(x.size)
    line = refined_line(unmeasured_line(50.0), 1, _fit_at(x), 50.0, np.array([25.05, 50.1]), 2.0)
    assert line == unmeasured_line(50.0)


def test_what_is_known_of_a_line_fades() -> None:
    """A second later a line is nearly where it was; an hour later it may be anywhere again."""
    line = unmeasured_line(50.0)
    near = type(line)(50.0, 49.96, 0.003, 10.0)
    assert near.later(11.0).sigma_hz < 0.004
    assert near.later(3610.0).sigma_hz == PRIOR_SIGMA_HZ
