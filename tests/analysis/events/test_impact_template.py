"""The waveform of an impact, learnt from few landings in noise."""

import numpy as np
import pytest

from analysis.events.impact_template import FINE, LEAD, MIN_ECHO, even, ringing_part, template_from_snippets
from daq.instrument.channel_limits import NoiseSpectrum

RATE_HZ = 20_000.0


def test_a_brief_impact_keeps_its_onset_in_the_noise_of_few_landings() -> None:
    """Ten landings whose mean is noisier than a tenth of the peak: the onset is the spike's, and nothing follows it."""
    rng = np.random.default_rng(5)
    spike, noise = np.array([-12.0, 7.0, -4.0, 2.0, -1.0]), 0.4
    snippets = noise * rng.standard_normal((10, MIN_ECHO))
    snippets[:, LEAD : LEAD + len(spike)] += spike * rng.uniform(0.3, 1.0, (10, 1))
    waveform = template_from_snippets(
        snippets, rng.uniform(0.0, 1.0, 10), NoiseSpectrum.white(noise, RATE_HZ), np.array([25.0]), np.zeros(1)
    )
    assert waveform is not None
    loud = np.flatnonzero(np.abs(waveform.fine) > 0.3 * np.abs(waveform.fine).max()) / FINE - LEAD
    assert loud.min() == pytest.approx(0.5, abs=1.0)
    assert np.all(waveform.fine[(LEAD + 12) * FINE :] == 0.0)


def test_what_goes_on_slowly_under_an_impact_is_no_part_of_it() -> None:
    """A plate that every landing sets swinging slowly: the waveform holds only the ringing, none of the swing."""
    rng = np.random.default_rng(6)
    echo = 128
    lag_s = (np.arange(echo) - LEAD + 0.5) / RATE_HZ
    rings = np.where(lag_s > 0.0, 30.0 * np.exp(-lag_s / 1e-3) * np.sin(2.0 * np.pi * 1700.0 * lag_s), 0.0)
    swings = np.where(lag_s > 0.0, -1.5 + 60.0 * lag_s, 0.0)
    snippets = rings + swings + 0.1 * rng.standard_normal((60, echo))
    waveform = template_from_snippets(
        snippets, np.full(60, 0.5), NoiseSpectrum.white(0.1, RATE_HZ), np.array([25.0]), np.zeros(1)
    )
    assert waveform is not None
    middle = slice((LEAD + 40) * FINE, (LEAD + 80) * FINE)
    mean = float(np.mean(waveform.fine[middle])) / float(np.max(np.abs(waveform.fine)))
    assert abs(mean) < 0.1 * 1.4 / 30.0


def test_what_swings_under_landings_at_one_place_between_samples_is_no_part_of_it() -> None:
    """A plate that rings: landings that hit the same place between two samples hit it in the same motion."""
    rng = np.random.default_rng(8)
    fraction = np.repeat(np.arange(FINE) / FINE, 10)
    lag_s = (np.arange(512) - LEAD + fraction[:, None]) / RATE_HZ
    rings = np.where(lag_s > 0.0, 30.0 * np.exp(-lag_s / 1e-3) * np.sin(2.0 * np.pi * 1700.0 * lag_s), 0.0)
    swings = 0.5 * np.sin(2.0 * np.pi * 60.0 * (lag_s + fraction[:, None] / 60.0))
    snippets = rings + swings + 0.1 * rng.standard_normal(rings.shape)
    waveform = template_from_snippets(
        snippets, fraction, NoiseSpectrum.white(0.1, RATE_HZ), np.array([25.0]), np.zeros(1)
    )
    assert waveform is not None
    after = waveform.fine[(LEAD + 40) * FINE : (LEAD + 60) * FINE].reshape(-1, FINE)
    assert np.ptp(np.mean(after, axis=0)) < 0.005 * np.max(waveform.fine)


@pytest.mark.parametrize("ringing_hz", [900.0, 2600.0, 6000.0])
def test_an_abrupt_beginning_is_no_slow_motion(ringing_hz: float) -> None:
    """A ringing that begins in a bend is the same waveform at every place between two samples, and stays as it is."""
    lag_s = (np.arange(60 * FINE) - LEAD * FINE) / FINE / RATE_HZ
    rings = np.where(lag_s > 0.0, np.exp(-lag_s / 6e-4) * np.sin(2.0 * np.pi * ringing_hz * lag_s), 0.0)
    assert np.max(np.abs(even(rings, RATE_HZ) - rings)) < 6e-4


def test_what_comes_after_a_silence_is_the_next_impact() -> None:
    """A ringing of some milliseconds ends where it is silent, though the next impact begins 25 ms after the first."""
    rng = np.random.default_rng(9)
    lag_s = (np.arange(512 * FINE) - LEAD * FINE) / FINE / RATE_HZ
    waves = [
        np.where((t := lag_s - at) > 0.0, np.exp(-t / 6e-4) * np.sin(5200.0 * np.pi * t), 0.0) for at in (0.0, 0.025)
    ]
    ringing = ringing_part(waves[0] + waves[1] + 1e-3 * rng.standard_normal(lag_s.size), 1e-3, RATE_HZ)
    assert ringing is not None
    assert ringing.size < (LEAD + 200) * FINE


def test_a_weak_landing_alone_does_not_blow_up_what_is_under_it() -> None:
    """Landings at one place between samples, and a weak one at another: the waveform is that of the strong ones."""
    rng = np.random.default_rng(7)
    size = np.append(np.ones(60), 0.02)
    snippets = 0.02 * rng.standard_normal((61, MIN_ECHO))
    snippets[:, LEAD : LEAD + 5] += size[:, None] * np.array([-12.0, 7.0, -4.0, 2.0, -1.0])
    snippets[:, LEAD + 5 :] += -1.0  # the plate's own, whatever the landing
    fractions = np.append(np.full(60, 0.5), 0.05)
    waveform = template_from_snippets(
        snippets, fractions, NoiseSpectrum.white(0.02, RATE_HZ), np.array([25.0]), np.zeros(1)
    )
    assert waveform is not None
    largest = float(np.max(np.abs(waveform.fine)))
    assert np.max(np.abs(waveform.fine[(LEAD + 10) * FINE :])) < 0.2 * largest


def test_a_template_shorter_than_its_smoothing_is_one() -> None:
    """48 samples at 100 kHz, half a millisecond: the brief ring in them is what is known."""
    points = np.arange(48 * FINE)
    ring = np.where((points > LEAD * FINE) & (points < (LEAD + 13) * FINE), np.cos(points / 5.0), 0.0)
    known = ringing_part(ring, 1e-4, 100_000.0)
    assert known is not None and known.size == points.size
    assert known == pytest.approx(ring, abs=0.05)


def test_a_slow_remainder_does_not_ring_at_its_end() -> None:
    """Under a brief ring, what a plate's motion left slopes on to the end of what was learnt: none of it is kept."""
    points = np.arange(128 * FINE)
    slow = -4e-5 * np.maximum(points - LEAD * FINE, 0) / FINE
    ring = np.where((points > LEAD * FINE) & (points < (LEAD + 8) * FINE), np.cos(points / 5.0), 0.0)
    known = ringing_part(ring + slow, 3e-4, 20000.0)
    assert known is not None
    assert np.all(known[(LEAD + 8 + 20) * FINE :] == 0.0)


@pytest.mark.parametrize("rings_v", [0.0, 2e-5])
def test_a_short_template_does_not_end_in_a_step(rings_v: float) -> None:
    """A pulse on a plate that then carries a ball: the plateau after it is cut off, and leaves no edge of its own; nor
    where something rings to the end of what was learnt."""
    rng, points = np.random.default_rng(8), 48 * FINE
    waveform = np.where(
        np.arange(points) // FINE == LEAD, -4e-3, np.where(np.arange(points) >= LEAD * FINE, -2e-4, 0.0)
    )
    waveform[-6 * FINE :] += rings_v * np.cos(np.pi * np.arange(6 * FINE) / FINE)
    known = ringing_part(waveform + 4e-6 * rng.standard_normal(points), 4e-6, 20000.0)
    assert known is not None
    end = int(np.flatnonzero(known)[-1])
    assert np.abs(known[end - 4 : end + 1]).max() < 4e-5  # a fifth of the plateau
    assert known[LEAD * FINE + 4] == pytest.approx(-4e-3, rel=0.02)


def test_what_a_plate_does_after_it_is_loaded_is_no_part_of_a_knock() -> None:
    """The load settles within some milliseconds; a faint hum much later makes the template long."""
    time_s = (np.arange(300 * FINE) - LEAD * FINE) / (FINE * 20000.0)
    knock = np.where(time_s >= 0.0, -8e-4 * np.sin(2.0 * np.pi * 3000.0 * time_s), 0.0)
    knock *= np.exp(-np.maximum(time_s, 0.0) / 8e-5)
    slow = np.where(time_s < 0.0, 0.0, 1.5e-5 * np.exp(-time_s / 2e-3))
    hum = np.where(time_s > 10.5e-3, 1e-6 * np.sin(2.0 * np.pi * 900.0 * time_s), 0.0)
    known = ringing_part(knock + slow + hum, 2e-7, 20000.0)
    assert known is not None
    assert abs(np.sum(known[time_s[: known.size] > 1.05e-3])) < 0.02 * np.sum(np.abs(knock))


def test_landings_that_were_only_heard_may_begin_a_sample_early() -> None:
    """Every other landing is placed a sample off: a first template for what will be placed by it, and no last one."""
    rng = np.random.default_rng(8)
    lag_s = (np.arange(MIN_ECHO) - LEAD + 0.5 - np.arange(60)[:, None] % 2) / RATE_HZ
    rings = np.where(lag_s > 0.0, 30.0 * np.exp(-lag_s / 5e-4) * np.sin(2.0 * np.pi * 3000.0 * lag_s), 0.0)
    heard = rings + 0.1 * rng.standard_normal(rings.shape), np.full(60, 0.5)
    noise = NoiseSpectrum.white(0.1, RATE_HZ), np.array([25.0]), np.zeros(1)
    assert template_from_snippets(*heard, *noise, aligned=False) is not None
    assert template_from_snippets(*heard, *noise) is None
