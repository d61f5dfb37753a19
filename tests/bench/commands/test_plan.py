"""`bench plan` as a person and as a machine call it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.profiles.find import shipped_folder, shipped_names

SIMULATED = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")


def bench(*arguments: str):
    """Call the command line in process."""
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_profiles_may_be_driven(name: str) -> None:
    """Every shipped profile's ramp is inside its own limits."""
    result = bench("plan", name, "--json", "-")
    assert result.exit_code == 0
    plan = json.loads(result.stdout)
    assert plan["forbidden"] == [] and plan["n_samples"] == sum(step["n_samples"] for step in plan["steps"])


def test_table_shows_every_step() -> None:
    """The table for a person has a row a step and the total."""
    result = bench("plan", "simulated")
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines() if line.strip()[:1].isdigit()]
    assert [row[1] for row in rows[:3]] == ["0.4", "0.5", "0.6"] and rows[0][2] == "0.8"
    assert "23 steps" in result.stdout


def test_a_limit_refuses_with_step_and_name(tmp_path: Path) -> None:
    """A ramp beyond a limit leaves with 2 and names each step and the limit."""
    path = tmp_path / "wild.toml"
    path.write_text(SIMULATED.replace("plate_mps2 = 120.0", "plate_mps2 = 48.0"), encoding="utf-8")
    result = bench("plan", str(path))
    assert result.exit_code == 2
    said = "step 21 (gamma 2.5) asks for 49.03 m/s^2 of plate acceleration; limits.plate_mps2 allows 48"
    assert said in result.stderr
    assert "step 20" not in result.stderr


def test_a_bad_profile_is_a_wrong_call(tmp_path: Path) -> None:
    """A profile with faults, and one that is not there, leave with 2 and a message."""
    path = tmp_path / "bad.toml"
    path.write_text(SIMULATED.replace("hold_cycles", "hold_cycle"), encoding="utf-8")
    result = bench("plan", str(path))
    assert result.exit_code == 2 and "ramp.hold_cycle: unknown key; did you mean hold_cycles?" in result.stderr
    result = bench("plan", "papre")
    assert result.exit_code == 2 and "did you mean paper?" in result.stderr


def test_a_ramp_of_many_steps_is_planned_in_short(tmp_path: Path) -> None:
    """Of 6000 steps the first and the last 500 are printed, the others counted; the length is in hours, too."""
    profile = tmp_path / "many.toml"
    profile.write_text(SIMULATED.replace("steps = 23", "steps = 6000"), encoding="utf-8")
    result = bench("plan", str(profile))
    assert result.exit_code == 0
    assert "5000 steps in the middle are not shown" in result.stdout
    assert "hours" in result.stdout


def test_a_ramp_of_years_is_refused(tmp_path: Path) -> None:
    """A ramp of years ends with exit 2 and its length, not with a table."""
    profile = tmp_path / "years.toml"
    profile.write_text(SIMULATED.replace("hold_cycles = 20", "hold_cycles = 100000000000"), encoding="utf-8")
    result = bench("plan", str(profile))
    assert result.exit_code == 2
    assert "a run lasts at most 30 days" in result.stderr
