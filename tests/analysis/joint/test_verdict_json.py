"""A joint verdict as JSON and on the terminal: what differs in one run is said to."""

import pytest

from analysis.joint.population import Constancy, OneRun
from analysis.joint.result import JointVerdict, OverRuns, RunOutcome, joint_json
from bench.terminal.loop_display import show_runs

CONSTANT = Constancy(9.0, 2, 0.01, 0.007, 0.0, float("inf"), 1.0)

LIMITS = {"viscous_damping.rate_per_s": 0.047}


def verdict(one: OneRun | None) -> JointVerdict:
    """Three runs with a drive gain, of which the last may be the only one that shows it."""
    gain = OverRuns(
        "drive_gain", "relative", "1", "effect", 0.0047, 0.004, 0.007, (0.0, 1e-4, 0.0142), (2e-4,) * 3, CONSTANT,
        True, one,
    )  # fmt: skip
    runs = tuple(
        RunOutcome(f"{x}.h5", "", 150, 10, 1.0, 1.0, 0.5, 27.0, 27.0, (), float(i)) for i, x in enumerate("abc")
    )
    return JointVerdict("explained", ("drive_gain",), (("drive_gain",),), (gain,), (), runs, LIMITS, (), (), 1, False)


def test_the_one_run_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    """JSON and terminal name the run, its value and what the others say together."""
    found = verdict(OneRun(2, 5e-5, 0.0035))
    one_run = joint_json(found)["parameters"][0]["one_run"]
    assert one_run == {"recording": "c.h5", "others": 5e-5, "others_sigma": 0.0035}
    show_runs(found)
    out = " ".join(capsys.readouterr().out.split())
    assert "drive_gain.relative is different in one run: c.h5 has 0.01420 +- 0.00020, all others together 0.0" in out


def test_what_the_runs_share_is_nobodys_alone(capsys: pytest.CaptureFixture[str]) -> None:
    """Without such a run JSON says null, and the terminal nothing."""
    assert joint_json(verdict(None))["parameters"][0]["one_run"] is None
    show_runs(verdict(None))
    assert "different in one run" not in capsys.readouterr().out


def test_what_all_runs_could_not_have_shown_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """JSON and terminal state the joint detection limits, with their units."""
    assert joint_json(verdict(None))["detection_limits"] == LIMITS
    show_runs(verdict(None))
    out = " ".join(capsys.readouterr().out.split())
    assert "could not have shown less than: viscous_damping.rate_per_s 0.047 1/s" in out
