"""A table that rings for longer than the usual template."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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
