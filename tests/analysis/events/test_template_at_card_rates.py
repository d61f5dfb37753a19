"""A sound card's rate: the analysis works at it, and finds what it finds at 20 kHz."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import FlightFlag, Flights, flights_of
from bench.profiles.find import load
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from rig.backends.simulated import SimulatedBackend
from rig.execution.run import run_ramp
from rig.profile import parse_profile
from rig.sim.scenario import Scenario
from tests.fakes.faults import Fault, FaultyBackend, LostFrames


def flights_at(rate_hz: int, folder: Path, faults: Sequence[Fault] = ()) -> Flights:
    """Flights of one short ramp on the ideal rig, sampled at ``rate_hz``, seen through ``faults``."""
    _, text = load("simulated")
    text = text.replace("rate_hz = 20000", f"rate_hz = {rate_hz}")
    profile = parse_profile(text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 1.0, stop = 2.2, steps = 5"))
    backend = FaultyBackend(SimulatedBackend(profile.sampling.rate_hz, Scenario("ideal"), 1), faults)
    path = folder / f"{rate_hz}.h5"
    writer = RecordingWriter(
        path, profile.setup(), profile_text=text, channels=backend.channels, scales=backend.scales, backend="simulated",
        simulated=True,
    )  # fmt: skip
    assert run_ramp(profile, backend, writer).how == "complete"
    with open_recording(path) as recording:
        return flights_of(recording)


@pytest.mark.parametrize("rate_hz", [44100, 48000, 96000])
def test_a_cards_rate_shows_the_same_flights(tmp_path: Path, rate_hz: int) -> None:
    """As many flights, as many launched again as they landed (the accelerometer's word), of the same lengths."""
    usual, card = flights_at(20000, tmp_path), flights_at(rate_hz, tmp_path)
    assert card.edges.sensor_offset is not None
    for flag in (FlightFlag.RELAUNCHED, FlightFlag.SETTLING):
        assert np.count_nonzero(card.has(flag)) == pytest.approx(np.count_nonzero(usual.has(flag)), abs=2)
    assert card.good().sum() == pytest.approx(usual.good().sum(), abs=2)
    lengths = [np.sort(flights.duration_s[flights.good() & (flights.step == 0)]) for flights in (usual, card)]
    assert np.median(lengths[0]) == pytest.approx(np.median(lengths[1]), abs=2e-6)


def test_a_loss_does_not_spoil_the_waveform_of_an_impact(tmp_path: Path) -> None:
    """Lost samples shift the motion's phase; what is learnt across them is an impact, and the plate stays as driven."""
    losses = [LostFrames(60_000 + 40_000 * k, 768, declared=True) for k in range(4)]
    for step in flights_at(48000, tmp_path, losses).plate.steps:
        assert step is not None and abs(step.gamma / step.gamma_drive - 1.0) < 1e-3
