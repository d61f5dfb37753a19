"""A table that rings for longer than the usual template."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.impact_template import FINE, LEAD, ringing_part, template_from_snippets
from analysis.events.template_estimate import _Found, _snippets
from analysis.flights.assemble import flights_of
from analysis.flights.scan import survey
from daq.instrument.noise_spectrum import NoiseSpectrum
from daq.recording import open_recording
from tests.analysis.conftest import Maker


def test_impacts_are_learnt_where_the_table_rings_through_the_flight(make: Maker) -> None:
    """780 Hz for 7 ms: the template is four times as long, flights are those of a quiet table, gamma is right to 0.2 %
    (4 % off with the usual template).
    """
    seen = []
    for rig in ({}, {"ring_frequency_hz": 780.0, "ring_decay_s": 0.007}):
        with open_recording(make(np.linspace(1.0, 2.2, 5), settle=10, hold=20, rig=rig).path) as recording:
            seen.append((flights_of(recording), survey(recording).template))
    (usual, short), (ringing, long) = seen
    assert short is not None and long is not None
    assert long.fine.size == pytest.approx(512 * FINE, rel=0.01) and short.fine.size < 0.3 * long.fine.size
    assert ringing.good().sum() == pytest.approx(usual.good().sum(), abs=2)
    for step in ringing.plate.steps:
        assert step is not None and abs(step.gamma / step.gamma_drive - 1.0) < 2e-3
    lengths = [np.median(x.duration_s[x.good() & (x.step == 0)]) for x in (usual, ringing)]
    assert lengths[0] == pytest.approx(lengths[1], abs=5e-6)


def test_landings_with_another_one_in_their_ringing_do_not_shape_the_template() -> None:
    """A 24-bit card: 48 of 80 landings are followed by a bounce after 2.5 to 5.5 ms; the ringing decays as it does."""
    rate_hz, rng = 25_600.0, np.random.default_rng(5)
    time_s = (np.arange(164) - LEAD) / rate_hz

    def ring(since_s: np.ndarray) -> np.ndarray:
        since_s = np.maximum(since_s, 0.0)
        return np.exp(-since_s / 0.001) * np.sin(2.0 * np.pi * 1500.0 * since_s)

    fractions = rng.random(80)
    late_s = np.where(np.arange(80) < 48, rng.uniform(0.0025, 0.0055, 80), 1.0)
    since_s = time_s + fractions[:, None] / rate_hz
    volts = ring(since_s) + 0.35 * ring(since_s - late_s[:, None]) + 3e-4 * rng.standard_normal((80, 164))
    template = template_from_snippets(volts, fractions, NoiseSpectrum.white(3e-4, rate_hz), np.array([25.0]))
    assert template is not None
    place_s = (np.arange(template.fine.size) / FINE - LEAD) / rate_hz
    size = np.abs(template.fine).max()
    for begin_s in (0.002, 0.003):
        own = (place_s > begin_s) & (place_s < begin_s + 1.0 / 1500.0)
        wave = np.abs(ring(place_s)).max()
        expected = np.abs(ring(place_s[own])).max() / wave
        assert np.abs(template.fine[own]).max() / size == pytest.approx(expected, rel=0.1)


def ring(since_s: np.ndarray, decay_s: float, hz: float = 1200.0) -> np.ndarray:
    """A mode that a landing starts."""
    since_s = np.maximum(since_s, 0.0)
    return np.asarray(np.exp(-since_s / decay_s) * np.sin(2.0 * np.pi * hz * since_s))


def test_ringing_that_a_template_cuts_off_is_continued_as_it_decays() -> None:
    """Landings stand 6.4 ms from others and the table rings for 2 ms: what follows is right to a part in a thousand."""
    points_hz = 25_600.0 * FINE
    time_s = (np.arange(round(6.4e-3 * points_hz)) - LEAD * FINE) / points_hz
    longer = ringing_part(ring(time_s, 2e-3), 1e-5, 25_600.0)
    assert longer is not None and longer.size > 3 * time_s.size
    every_s = (np.arange(longer.size) - LEAD * FINE) / points_hz
    assert longer == pytest.approx(ring(every_s, 2e-3), abs=1e-3)
    quick = ringing_part(ring(time_s, 1e-3) + ring(time_s, 1e-3, 1700.0), 1e-5, 25_600.0)
    assert quick is not None and quick.size == time_s.size  # no single mode, and little of it is cut off
    assert ringing_part(ring(time_s, 2e-3) + ring(time_s, 2e-3, 1700.0), 1e-5, 25_600.0) is None


def test_motion_that_bends_under_long_ringing_is_no_part_of_it() -> None:
    """25 ms of ringing over what a misfit of the forcing left: a twentieth of that stays in the waveform."""
    points_hz = 25_600.0 * FINE
    time_s = (np.arange(round(25.6e-3 * points_hz)) - LEAD * FINE) / points_hz
    slow = 0.003 * np.sin(2.0 * np.pi * 27.3 * time_s + 2.0) * np.clip(time_s / 2e-4, 0.0, 1.0)
    known = ringing_part(ring(time_s, 7e-3) + slow, 1e-6, 25_600.0)
    assert known is not None
    left = (known - ring(time_s, 7e-3))[time_s > 2e-3]
    assert np.abs(left[: -FINE * 30].mean()) < 0.05 * 0.003 and left[: -FINE * 30].std() < 0.1 * 0.003


def test_what_a_loud_impact_still_rings_does_not_keep_it_from_the_template() -> None:
    """Of three impacts that stand 3 ms from others, the one with a far weaker neighbour serves, the others do not."""
    places = np.array([400.0, 460.0, 1400.0, 1460.0])
    found = _Found(places, np.array([1000.0, 20.0, 1000.0, 300.0]), np.ones(4, dtype=np.bool_))
    volts = np.arange(2000.0)
    snippets, _ = _snippets(volts, np.ones(2000, dtype=np.bool_), found, 128)
    assert snippets[:, LEAD].tolist() == [400.0]
