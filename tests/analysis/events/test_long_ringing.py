"""A table that rings for longer than the usual template."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.events.accelerometer_noise import NoiseSpectrum
from analysis.events.impact_template import FINE, LEAD, template_from_snippets
from analysis.flights.assemble import flights_of
from analysis.flights.scan import survey
from bench.profiles.find import load
from daq.recording import Recording, RecordingWriter, open_recording
from rig.backends.simulated import SimulatedBackend
from rig.execution.run import run_ramp
from rig.profile import parse_profile
from rig.sim.scenario import Scenario


def ramp(folder: Path, rig: dict[str, float]) -> Recording:
    """One short ramp of the ideal ball on a simulated rig."""
    _, text = load("simulated")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 1.0, stop = 2.2, steps = 5")
    profile = parse_profile(text)
    backend = SimulatedBackend(profile.sampling.rate_hz, Scenario("ringing", rig=rig), 1)
    path = folder / f"{len(rig)}.h5"
    writer = RecordingWriter(
        path, profile.setup(), profile_text=text, channels=backend.channels, scales=backend.scales, backend="simulated",
        simulated=True,
    )  # fmt: skip
    assert run_ramp(profile, backend, writer).how == "complete"
    return open_recording(path)


def test_impacts_are_learnt_where_the_table_rings_through_the_flight(tmp_path: Path) -> None:
    """780 Hz for 7 ms: the template is four times as long, and plate and flights are those of a table that is quiet."""
    with ramp(tmp_path, {}) as recording:
        usual, short = flights_of(recording), survey(recording).template
    with ramp(tmp_path, {"ring_frequency_hz": 780.0, "ring_decay_s": 0.007}) as recording:
        ringing, long = flights_of(recording), survey(recording).template
    assert short is not None and long is not None
    assert long.fine.size == pytest.approx(4 * short.fine.size, rel=0.01)
    assert ringing.good().sum() == pytest.approx(usual.good().sum(), abs=2)
    for step in ringing.plate.steps:
        assert step is not None and abs(step.gamma / step.gamma_drive - 1.0) < 1e-3
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
