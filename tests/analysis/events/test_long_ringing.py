"""A table that rings for longer than the usual template."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.impact_template import FINE, LEAD, ringing_part, template_from_snippets
from analysis.events.template_estimate import _all_snippets, _begun, _Found, _prediction, _snippets
from analysis.flights.assemble import flights_of
from analysis.flights.scan import survey
from daq.instrument.channel_limits import NoiseSpectrum
from daq.recording import open_recording
from tests.analysis.conftest import Maker


def test_impacts_are_learnt_where_the_table_rings_through_the_flight(make: Maker) -> None:
    """780 Hz for 7 ms: the template is several times as long, flights are those of a quiet table, gamma is right to
    0.2 % (4 % off with the usual template).
    """
    seen = []
    for rig in ({}, {"ring_frequency_hz": 780.0, "ring_decay_s": 0.007}):
        with open_recording(make(np.linspace(1.0, 2.2, 5), settle=10, hold=20, rig=rig).path) as recording:
            seen.append((flights_of(recording), survey(recording).template))
    (usual, short), (ringing, long) = seen
    assert short is not None and long is not None
    assert long.fine.size > 512 * FINE and short.fine.size < 0.3 * long.fine.size
    assert ringing.good().sum() == pytest.approx(usual.good().sum(), abs=2)
    for step in ringing.plate.steps:
        assert step is not None and abs(step.gamma / step.gamma_drive - 1.0) < 2e-3
    lengths = [np.median(x.duration_s[x.good() & (x.step == 0)]) for x in (usual, ringing)]
    assert lengths[0] == pytest.approx(lengths[1], abs=5e-6)


def test_landings_that_all_bounce_do_not_shape_the_template() -> None:
    """780 Hz for 7 ms, and each of 60 landings is followed by another one 2 to 4 ms later: the ringing is continued as
    it decays.
    """
    rate_hz, rng = 25_600.0, np.random.default_rng(5)
    places = 800.0 * np.arange(1, 61) + 5.0 * rng.random(60)
    time = np.arange(50_000.0)
    volts = 3e-4 * rng.standard_normal(time.size)
    for place, later in zip(places, rng.uniform(52.0, 102.0, 60), strict=True):
        for at, size_v in ((place, 1.0), (place + later, 0.25)):
            volts += size_v * ring((time - at) / rate_hz, 7e-3, 780.0)
    still = [(volts, np.ones(time.size, dtype=np.bool_))]
    prediction, left = _prediction(still, 3e-4)
    snippets, fractions = _all_snippets(still, [_begun(left[0])], rate_hz, None, 1)
    assert len(snippets) > 50 and np.isnan(snippets[:, LEAD + 110]).all()
    noise = NoiseSpectrum.white(3e-4, rate_hz)
    template = template_from_snippets(snippets, fractions, noise, np.array([25.0]), prediction)
    assert template is not None
    place_s = (np.arange(template.fine.size) / FINE - LEAD) / rate_hz
    own = (place_s > 0.0) & (place_s < 20e-3)
    size = np.linalg.norm(template.fine[own]) / np.linalg.norm(ring(place_s[own], 7e-3, 780.0))
    assert template.fine[own] / size == pytest.approx(ring(place_s[own], 7e-3, 780.0), abs=0.1)


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
    assert quick is not None and quick.size - time_s.size < FINE  # no single mode, and little of it is cut off
    assert ringing_part(ring(time_s, 2e-3) + ring(time_s, 2e-3, 1700.0), 1e-5, 25_600.0) is None


def test_motion_that_bends_under_long_ringing_is_no_part_of_it() -> None:
    """25 ms of ringing over what a misfit of the forcing left: a twentieth of that stays in the waveform."""
    points_hz = 25_600.0 * FINE
    time_s = (np.arange(round(25.6e-3 * points_hz)) - LEAD * FINE) / points_hz
    slow = 0.003 * np.sin(2.0 * np.pi * 27.3 * time_s + 2.0) * np.clip(time_s / 2e-4, 0.0, 1.0)
    known = ringing_part(ring(time_s, 7e-3) + slow, 1e-6, 25_600.0)
    assert known is not None
    left = (known[: time_s.size] - ring(time_s, 7e-3))[time_s > 2e-3]
    assert np.abs(left[: -FINE * 30].mean()) < 0.05 * 0.003 and left[: -FINE * 30].std() < 0.1 * 0.003


@pytest.mark.parametrize("slow_hz", [50.0, 100.0])
def test_motion_that_bends_under_a_short_waveform_of_one_mode_is_no_part_of_it(slow_hz: float) -> None:
    """7 ms of ringing over a motion that begins with the impact: a twentieth of that stays in the waveform."""
    points_hz = 25_600.0 * FINE
    time_s = (np.arange(round(7.5e-3 * points_hz)) - LEAD * FINE) / points_hz
    slow = 0.01 * np.where(time_s > 0.0, np.sin(2.0 * np.pi * slow_hz * time_s + 0.5) - np.sin(0.5), 0.0)
    known = ringing_part(ring(time_s, 1e-3) + slow, 1e-4, 25_600.0)
    assert known is not None
    n = min(known.size, time_s.size)
    left = (known[:n] - ring(time_s[:n], 1e-3))[time_s[:n] > 2.6e-3]
    assert np.abs(left).max() < 0.05 * 0.01


@pytest.mark.parametrize("mode_hz", [800.0, 1500.0])
def test_motion_that_bends_under_ringing_that_dies_away_is_no_part_of_it(mode_hz: float) -> None:
    """Two modes over what a misfit of the forcing left: a twentieth of that stays in the waveform."""
    points_hz = 25_600.0 * FINE
    time_s = (np.arange(round(25.6e-3 * points_hz)) - LEAD * FINE) / points_hz
    rings = ring(time_s, 2.0 / mode_hz, mode_hz) + ring(time_s, 1.0 / mode_hz, 2.0 * mode_hz)
    slow = 0.003 * np.sin(2.0 * np.pi * 60.0 * time_s + 2.0) * np.clip(time_s / 2e-4, 0.0, 1.0)
    known = ringing_part(rings + slow, 1e-4, 25_600.0)
    assert known is not None
    late = (time_s > 6e-3) & (time_s < 9e-3)
    left = known[: time_s.size][late[: known.size]] - rings[late]
    assert abs(left.mean()) < 0.05 * 0.003


def test_a_landing_serves_up_to_the_next_one_that_is_not_far_weaker() -> None:
    """Of two pairs of impacts 3 ms apart, one with a far weaker second: both first ones serve, one of them for 3 ms."""
    places, strength = np.array([400.0, 460.0, 1400.0, 1460.0]), np.array([1000.0, 20.0, 1000.0, 300.0])
    found = _Found(places, strength, np.zeros(4), np.array([np.inf, np.inf, 60.0, np.inf]))
    snippets, _ = _snippets(np.arange(2000.0), np.ones(2000, dtype=np.bool_), found, 12.0, 128, None)
    assert snippets[:, LEAD].tolist() == [400.0, 1400.0]
    assert np.isfinite(snippets).sum(axis=1).tolist() == [128, LEAD + 61]


def test_slow_motion_before_a_decay_is_not_a_single_point() -> None:
    """A weak second mode that lasts into the decay of the first is not taken for slow motion before that."""
    points_hz = 25_600.0 * FINE
    time_s = (np.arange(round(23.7e-3 * points_hz)) - LEAD * FINE) / points_hz
    rings = ring(time_s, 2.7e-3, 1500.0) + 0.03 * ring(time_s, 2e-3, 4100.0)
    known = ringing_part(rings, 1e-5, 25_600.0)
    assert known is not None
    left = (known[: time_s.size] - rings)[(time_s > 1e-3) & (time_s < 4e-3)]
    assert np.abs(left.mean()) < 3e-4
