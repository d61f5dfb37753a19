"""What the operator sees while a ramp runs: every figure is there, and within a usual terminal's width."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.profiles.find import load
from bench.terminal.run_console import health_line, limits_line, run_display, step_line
from daq.recording.writer import RecordingWriter
from rig.backends.simulated import SimulatedBackend
from rig.execution.operator import Status
from rig.execution.run import run_ramp
from rig.programme.sequencer import State
from rig.sim.scenario import Scenario
from tests.fakes.faults import Fault, FaultyBackend, LooseCable, LostFrames


def seen(tmp_path: Path, faults: list[Fault]) -> list[Status]:
    """Every status of a run of two steps whose second one lets the ball fly."""
    profile, _ = load("simulated")
    limits = profile.limits.model_copy(update={"velocity_mps": 0.5})
    ramp = profile.ramp.model_copy(update={"gamma": (0.4, 0.9), "order": None})
    profile = profile.model_copy(update={"ramp": ramp, "limits": limits})
    rig = FaultyBackend(SimulatedBackend(20000.0, Scenario("ideal"), 1), faults)
    writer = RecordingWriter(
        tmp_path / "run.h5", profile.setup(), profile_text="", channels=rig.channels, scales=rig.scales,
        backend=rig.name, simulated=True,
    )  # fmt: skip
    statuses: list[Status] = []
    run_ramp(profile, rig, writer, progress=statuses.append)
    return statuses


def test_the_lines_hold_every_figure(tmp_path: Path) -> None:
    """Step, commanded and achieved gamma, contact, lost samples and each limit, in lines of at most 80 characters."""
    statuses = seen(tmp_path, [LostFrames(30_000, 100, declared=True)])
    before, last = statuses[10], statuses[-1]
    assert step_line(before) == "step 0 (last 1), fading"
    assert "achieved -;" in health_line(before) and "contact alive; 0 samples lost" in health_line(before)
    held = next(s for s in statuses if s.step.index == 1 and s.achieved_gamma > 0.1)
    assert health_line(held).startswith(("gamma 0.9, achieved 0.39", "gamma 0.9, achieved 0.40"))
    assert "+- 0.002 (last hold)" in health_line(held)
    assert "100 samples lost" in health_line(last)
    loud = next(s for s in reversed(statuses) if s.state is State.HOLDING)
    parts = dict(part.rsplit(" ", 1) for part in limits_line(loud).removeprefix("of the limits: ").split(", "))
    assert list(parts) == ["drive", "acceleration", "velocity", "displacement"]
    assert {name: int(part.rstrip("%")) > 0 for name, part in parts.items()} == dict.fromkeys(parts, True)
    assert max(len(line(s)) for s in statuses for line in (step_line, health_line, limits_line)) <= 80


def test_a_contact_that_is_gone_shows(tmp_path: Path) -> None:
    """A wire that comes off is told in cycles long before the interlock stops the run."""
    cut = LooseCable("continuity", 20_000, 10**9, np.random.default_rng(1), 5.0, 0.002, 1e9)
    statuses = seen(tmp_path, [cut])
    silent = [health_line(s) for s in statuses if s.contact_age_cycles > 5]
    assert silent and all("contact silent for " in line for line in silent)


def test_the_display_draws_and_keeps_quiet(tmp_path: Path, capsys) -> None:
    """Everything goes to standard error; asked to be quiet, nothing goes anywhere."""
    status = seen(tmp_path, [])[-1]
    with run_display(quiet=False) as show:
        show(status)
    out = capsys.readouterr()
    assert out.out == "" and "of the limits: drive" in out.err and "contact alive" in out.err
    assert out.err.endswith("\n"), "what is written after it to a log begins a line"
    with run_display(quiet=True) as show:
        show(status)
    assert capsys.readouterr() == ("", "")
