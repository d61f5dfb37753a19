"""A recording of a held ball: the branch as measured, and predictions with the drive as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from analysis.flights.assemble import flights_of
from analysis.report.figures.flights import draw_bifurcations, measured
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.held import held_steps
from analysis.residuals.observations import observed
from bench.jobs.run_ramp import branch_hold
from bench.profiles.find import load
from daq.recording import Recording, open_recording
from daq.recording.writer import RecordingWriter
from rig.execution.run import run_ramp
from rig.profile import BranchTable, ControlTable
from rig.sim.scenario import Scenario
from tests.fakes.delayed import Delayed


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Five steps to gamma_peak 5 behind a device 5 ms late, with kicks."""
    profile, text = load("simulated")
    gammas = (1.75, 1.95, 2.15, 2.35, 2.5)
    ramp = {"gamma": gammas, "order": None, "settle_cycles": 14, "hold_cycles": 40, "slew_per_cycle": 0.01}
    profile = profile.model_copy(update={"ramp": profile.ramp.model_copy(update=ramp)})
    rig = Delayed(profile.sampling.rate_hz, Scenario("ideal"), 5).behind(100)
    path = tmp_path_factory.mktemp("held") / "run.h5"
    writer = RecordingWriter(
        Path(path), profile.setup(), profile_text=text, channels=rig.channels, scales=rig.scales, backend=rig.name,
        simulated=True,
    )  # fmt: skip
    kicked = profile.model_copy(update={"control": ControlTable(branch=BranchTable(kick=0.0015))})
    assert run_ramp(profile, rig, writer, hold=branch_hold(kicked)).how == "complete"
    return open_recording(path)


def test_phase_and_multiplier_are_measured(held: Recording) -> None:
    """Each held step: the exact phase to 1 mrad, the exact multiplier to 3 %, a flight time of one period."""
    found = held_steps(held, flights_of(held))
    assert [one.step for one in found] == [0, 1, 2, 3, 4]
    for one in found:
        peak = 2.0 * one.gamma
        exact = 1.0 - np.sqrt(peak**2 - np.pi**2)
        assert one.held > 0.95 and one.correction_rms < 0.01 and one.correction_mean < 1e-3
        assert abs(one.flight_s - 1.0 / 25.37) < 2.0 * one.flight_uncertainty_s
        assert one.phase == pytest.approx(np.arccos(np.pi / peak), abs=2e-3)
        assert one.multiplier == pytest.approx(exact, rel=0.03)
        assert one.interval[1] - one.interval[0] < 0.1 * abs(exact)


def test_flights_are_predicted_with_the_drive_as_it_was(held: Recording) -> None:
    """With the corrections of the recording landings are predicted five times as well as without them."""
    seen = observed(held, flights_of(held))
    rms = []
    for of in (seen, replace(seen, measured=replace(seen.measured, part=None, ahead_s=None))):
        left = ForwardModel(of, {}).residuals({}).landing_s[of.scored]
        rms.append(1e6 * float(np.sqrt(np.nanmean(left**2))))
    assert rms[0] < 6.0
    assert rms[0] < 0.2 * rms[1]


def test_the_measured_diagram_marks_what_was_held(held: Recording) -> None:
    """Held steps have a mark of their own, on the predicted unstable branch behind them."""
    figure = Figure()
    draw_bifurcations(measured(held, flights_of(held)), figure)
    drawn = {str(line.get_label()): np.asarray(line.get_xydata()) for line in figure.axes[0].lines}
    marks, branch = drawn["held on the branch"], drawn["unstable cycle, predicted"]
    assert len(marks) == 5
    np.testing.assert_allclose(marks[:, 1], 1e3 / 25.37, rtol=0, atol=0.02)
    assert branch[np.isfinite(branch[:, 1]), 0].min() == pytest.approx(3.724, abs=0.03)
