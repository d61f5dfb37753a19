"""`bench predict --profile`: declared effects of the ball, the drive and the amplitude loop in the prediction."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.predict.profile_ramp import print_ramp

SIMULATED = (Path(__file__).parents[3] / "rig_profiles" / "simulated.toml").read_text(encoding="utf-8")


def predicted(folder: Path, text: str, *options: str, code: int = 0) -> object:
    """The JSON of `bench predict` with the profile ``text``; its message where it should fail."""
    path = folder / "p.toml"
    path.write_text(text, encoding="utf-8")
    result = CliRunner().invoke(app, ["predict", "--profile", str(path), *options, "--json", "-"])
    assert result.exit_code == code, result.output
    return json.loads(result.stdout) if code == 0 else result.stderr


def with_declared(lines: str) -> str:
    """The simulated rig's profile with something declared."""
    return SIMULATED + "\n" + lines + "\n"


def test_declared_friction_is_in_the_prediction(tmp_path: Path) -> None:
    """Friction 0.3 of the profile: the flight that --effect gives, in seconds at the profile's frequency."""
    text = with_declared("[declared.coulomb_friction]\nmu_up = 0.3\nmu_down = 0.3")
    found = predicted(tmp_path, text, "--gamma", "1.0")
    plain = CliRunner().invoke(app, ["predict", "--gamma", "1", "--effect", "coulomb_friction.mu=0.3", "--json", "-"])
    assert found["tau"] == pytest.approx(json.loads(plain.stdout)["tau"], abs=1e-12)  # type: ignore[index]
    assert found["flight_time_s"][0] == pytest.approx(found["tau"][0] / (2 * 3.141592653589793 * 25.37))  # type: ignore[index]


def test_a_declared_drive_gain_makes_the_plate_move_more(tmp_path: Path) -> None:
    """Asked for gamma 1 with 10 % too much gain, the plate has 1.1; with compression, what the formula says."""
    gain = predicted(tmp_path, with_declared("[declared.drive_gain]\nrelative = 0.1"), "--gamma", "1.0")
    assert gain["gamma"] == pytest.approx(1.1)  # type: ignore[index]
    text = with_declared("[declared.gain_compression]\nper_g2 = 0.05")
    assert predicted(tmp_path, text, "--gamma", "1.0")["gamma"] == pytest.approx(1 / (1 + 0.05 * 4.0))  # type: ignore[index]


def test_the_ramp_of_the_profile_step_by_step(tmp_path: Path) -> None:
    """Without a gamma: every step asked for, at the plate's gamma; a loop that trusts its accelerometer errs by it."""
    text = with_declared("[declared.accelerometer_gain]\nrelative = 0.25\n[declared.drive_gain]\nrelative = 0.1")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 0.4, stop = 1.2, steps = 3")
    rows = predicted(tmp_path, text)
    assert [r["asked_gamma"] for r in rows] == pytest.approx([0.4, 0.8, 1.2])  # type: ignore[attr-defined]
    assert [r["gamma"] for r in rows] == pytest.approx([0.44, 0.88, 1.32])  # type: ignore[attr-defined]
    assert rows[0]["flights"] == 0 and rows[2]["flights"] == 1  # type: ignore[index]
    looped = predicted(tmp_path, text.replace("# [control]", "[control]").replace("# tolerance =", "tolerance ="))
    assert [r["gamma"] for r in looped] == pytest.approx([0.32, 0.64, 0.96])  # type: ignore[attr-defined]


def test_what_contradicts_is_refused(tmp_path: Path) -> None:
    """Another c beside the profile's, and two tones of unequal size, are refused in one line."""
    assert "forcing.ratio = 1" in str(predicted(tmp_path, SIMULATED, "--c", "3", "--gamma", "1", code=2))
    text = SIMULATED.replace("ratio = 1 ", "ratio = 2 ").replace("amplitude = [1.0, 1.0]", "amplitude = [1.0, 0.5]")
    assert "equal size" in str(predicted(tmp_path, text, "--gamma", "1", code=2))


def test_words_of_a_cycle_are_defined_below_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    """Motions are named as `bench predict` names an orbit, and every name stands explained below."""
    names = ("step", "asked_gamma", "gamma", "flights", "kind", "locked", "period", "flight_time_s")
    rows = [(0, 1.7, 1.7, 1, "periodic", True, 1, [0.039]), (1, 2.4, 2.4, 1, "periodic", False, 2, [0.0655])]
    print_ramp([dict(zip(names, row, strict=True)) for row in rows])
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].endswith("1-cycle locked, period 1: 39.000") and "1-cycle with reset, period 2: 65.5" in lines[2]
    assert lines[-2].startswith("gamma = A w^2/g") and lines[-1].startswith("n-cycle: ")


def test_what_if_replaces_values_and_a_lighter_ball_strikes_the_table_less(tmp_path: Path) -> None:
    """Half the ball's mass is half its ratio to the table's, twice a damping's rate; what is not there is refused."""
    declared = (
        "[declared.table_resonance]\nmass_ratio = {}\nfrequency_hz = 7.5\n[declared.viscous_damping]\nrate_per_s = {}"
    )
    light = predicted(tmp_path, with_declared(declared.format(0.02, 6.0)), "--gamma", "1.0")
    heavy = with_declared(declared.format(0.04, 3.0))
    mass = f"ball.mass_kg={0.5 * 0.2492}"
    assert predicted(tmp_path, heavy, "--gamma", "1.0", "--what-if", mass) == light
    values = ("--what-if", "table_resonance.mass_ratio=0.02", "--what-if", "viscous_damping.rate_per_s=6")
    assert predicted(tmp_path, heavy, "--gamma", "1.0", *values) == light
    for change in ("ball.mas_kg=1", "ball.mass_kg=0", "restitution.e0=0.3", "ball.mass_kg"):
        assert "--what-if" in str(predicted(tmp_path, heavy, "--gamma", "1.0", "--what-if", change, code=2))
