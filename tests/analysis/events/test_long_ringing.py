"""A table that rings for longer than the usual template."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.impact_template import FINE, LEAD, template_from_snippets
from analysis.flights.assemble import flights_of
from analysis.flights.scan import survey
from daq.instrument.noise_spectrum import NoiseSpectrum
from daq.recording import open_recording
from tests.analysis.conftest import Maker


def test_impacts_are_learnt_where_the_table_rings_through_the_flight(make: Maker) -> None:
    """780 Hz for 7 ms: the template is four times as long, flights are those of a quiet table, gamma is right to 0.3 %
    (4 % off with the usual template; what is left of the ringing bends it by 0.2 %).
    """
    seen = []
    for rig in ({}, {"ring_frequency_hz": 780.0, "ring_decay_s": 0.007}):
        with open_recording(make(np.linspace(1.0, 2.2, 5), settle=10, hold=20, rig=rig).path) as recording:
            seen.append((flights_of(recording), survey(recording).template))
    (usual, short), (ringing, long) = seen
    assert short is not None and long is not None
    assert long.fine.size == pytest.approx(4 * short.fine.size, rel=0.01)
    assert ringing.good().sum() == pytest.approx(usual.good().sum(), abs=2)
    for step in ringing.plate.steps:
        assert step is not None and abs(step.gamma / step.gamma_drive - 1.0) < 3e-3
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
