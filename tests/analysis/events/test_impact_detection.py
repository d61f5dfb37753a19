"""Impacts detected in successive pieces."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.impact_detection import ImpactScan, _match
from analysis.events.impact_template import LEAD, ImpactTemplate, echo_samples, template_from_snippets
from analysis.signals import PAD
from daq.instrument.channel_limits import NoiseSpectrum

RATE_HZ = 20000.0


def ringing(n: int, at: np.ndarray, rng: np.random.Generator, size_v: float = 0.6) -> np.ndarray:
    """Accelerometer volts with impacts ``at`` samples that ring at 1.7 kHz, in noise of 3 mV."""
    volts = 0.003 * rng.standard_normal(n)
    for place in at:
        own = np.arange(int(place) + 1, min(int(place) + 400, n))
        since = (own - place) / RATE_HZ
        volts[own] += size_v * np.exp(-since / 1e-3) * np.sin(2 * np.pi * 1700.0 * since)
    return volts.astype(np.float32)


@pytest.fixture(scope="module")
def waveform() -> ImpactTemplate:
    """Learnt from lone impacts."""
    rng = np.random.default_rng(0)
    at = 400.0 + 700.0 * np.arange(40) + rng.random(40)
    volts = ringing(29000, at, rng)
    first = np.ceil(at).astype(int)
    snippets = np.array([volts[b - LEAD : b - LEAD + echo_samples(RATE_HZ)] for b in first], dtype=np.float64)
    learnt = template_from_snippets(
        snippets, first - at, NoiseSpectrum.white(0.003, RATE_HZ), np.array([25.37]), np.zeros(1)
    )
    assert learnt is not None
    return learnt


@pytest.mark.parametrize("early", range(2, 34, 4))
def test_no_impact_is_detected_before_itself_at_the_end_of_a_piece(waveform: ImpactTemplate, early: int) -> None:
    """A piece that ends shortly before an impact begins does not take the echo of the filter for one."""
    rng = np.random.default_rng(1)
    volts = ringing(4000, np.array([2000.3]), rng)
    scan = ImpactScan(waveform, RATE_HZ)
    middle = 2000 - early
    scan.add(volts[: middle + PAD], PAD, PAD, middle - PAD)
    scan.add(volts[middle - PAD :], middle, PAD, 4000 - middle - PAD)
    assert scan.impacts().time_s * RATE_HZ == pytest.approx([2000.3], abs=0.3)


def test_a_weak_impact_is_not_found_a_period_of_its_ringing_late(waveform: ImpactTemplate) -> None:
    """300 impacts of some 9 standard deviations: the maximum a period later is their own, however noise raises it."""
    rng = np.random.default_rng(2)
    at = 400.0 + 300.0 * np.arange(300) + rng.random(300)
    volts = ringing(91_000, at, rng, 0.013)
    scan = ImpactScan(waveform, RATE_HZ)
    scan.add(volts, PAD, PAD, volts.size - 2 * PAD)
    found = scan.impacts().time_s * RATE_HZ
    late = found - at[np.clip(np.searchsorted(at, found) - 1, 0, 299)]
    assert found.size > 280
    assert np.all((late < 3.0) | (late > 290.0))


def test_an_impact_of_a_chatter_is_not_hidden_by_the_ringing_of_the_one_before(waveform: ImpactTemplate) -> None:
    """Three periods after a louder one the next bounce rings in step with it, and the one after makes it look later."""
    rng = np.random.default_rng(4)
    first = 1400.0 + 600.0 * np.arange(37) + rng.random(37)
    second = first + 35.1
    hits = (first, 0.6), (second, 0.11), (second + 10.0, 0.03)
    volts = np.sum([ringing(25_000, at, rng, size_v) for at, size_v in hits], axis=0)
    scan = ImpactScan(waveform, RATE_HZ)
    scan.add(volts, PAD, PAD, volts.size - 2 * PAD)
    found = scan.impacts().time_s * RATE_HZ
    assert np.all(np.min(np.abs(found[:, None] - second), axis=0) < 1.0)


def test_a_bounce_that_cancels_the_ringing_of_the_one_before_is_found(waveform: ImpactTemplate) -> None:
    """Two and a half periods after an impact, as loud as that still rings: the sum of both is hardly a maximum."""
    rng = np.random.default_rng(3)
    first = 1200.0 + 600.0 * np.arange(36) + rng.random(36)
    second = first + 2.5 * RATE_HZ / 1700.0
    volts = ringing(25_000, first, rng) + ringing(25_000, second, rng, 0.6 * np.exp(-2.5 / 1.7))
    scan = ImpactScan(waveform, RATE_HZ)
    scan.add(volts, PAD, PAD, volts.size - 2 * PAD)
    found = scan.impacts().time_s[scan.impacts().strength > 10.0] * RATE_HZ
    assert found == pytest.approx(np.sort(np.append(first, second)), abs=0.5)


@pytest.mark.parametrize(("periods", "after"), [(2.5, 8), (2.5, 24), (3.5, 36), (1.5, 20), (1.5, 40)])
def test_impacts_do_not_depend_on_where_a_piece_ends(waveform: ImpactTemplate, periods: float, after: int) -> None:
    """A piece ends ``after`` samples behind an impact, before or behind its bounce in antiphase: both, and no other."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        at = 2000.0 + rng.random() + np.array([0.0, periods * RATE_HZ / 1700.0])
        volts = ringing(4000, at[:1], rng) + ringing(4000, at[1:], rng, 0.6 * np.exp(-periods / 1.7))
        scan, middle = ImpactScan(waveform, RATE_HZ), 2000 + after
        scan.add(volts[: middle + PAD], PAD, PAD, middle - PAD)
        scan.add(volts[middle - PAD :], middle, PAD, 4000 - middle - PAD)
        assert scan.impacts().time_s * RATE_HZ == pytest.approx(at, abs=0.5)


def test_what_a_converters_filter_rings_long_before_an_impact_is_none(waveform: ImpactTemplate) -> None:
    """45 samples before an impact of 14,000 standard deviations something of 9 is no impact; far from any it is one."""
    rng = np.random.default_rng(6)
    volts = ringing(6000, np.array([2500.3]), rng, 20.0)
    volts += ringing(6000, np.array([1500.0, 2455.0]), rng, 0.013)
    scan = ImpactScan(waveform, RATE_HZ)
    scan.add(volts, PAD, PAD, volts.size - 2 * PAD)
    assert scan.impacts().time_s[:2] * RATE_HZ == pytest.approx([1500.0, 2500.3], abs=1.0)


def test_the_filter_is_the_correlation_with_its_taps(waveform: ImpactTemplate) -> None:
    """What the filter gives at every sample, over tiles whole and broken, is NumPy's correlation."""
    rng = np.random.default_rng(8)
    volts = rng.normal(0.0, 0.003, 2 * PAD + 777).astype(np.float32)
    out = np.empty(777, np.float32)
    _match(volts, PAD, waveform.taps, out)
    own = volts[PAD - LEAD : PAD - LEAD + 777 + waveform.taps.size - 1]
    np.testing.assert_allclose(out, np.correlate(own.astype(np.float64), waveform.taps), rtol=0, atol=2e-5)


def test_what_a_subtraction_leaves_is_taken_away_as_well(waveform: ImpactTemplate) -> None:
    """A rebound of a seventh of what still rings is no sure impact; its own ringing is subtracted all the same."""
    rng = np.random.default_rng(8)
    first = 1200.0 + 600.0 * np.arange(36) + rng.random(36)
    volts = ringing(25_000, first, rng) + ringing(25_000, first + 31.3, rng, 0.02)
    scan, remains = ImpactScan(waveform, RATE_HZ), ImpactScan(waveform, RATE_HZ, every=True)
    left = []
    for detector in (scan, remains):
        detector.add(volts, PAD, PAD, volts.size - 2 * PAD)
        detector.subtract_impacts(volts, PAD, PAD)
        left.append(np.sqrt(np.mean([np.var(volts[b + 35 : b + 60]) for b in first.astype(int)])))
    assert scan.impacts().time_s.size == 36
    noise = 0.003 * np.sqrt(2.0)
    assert left[0] > 1.5 * noise
    assert left[1] < 1.15 * noise
