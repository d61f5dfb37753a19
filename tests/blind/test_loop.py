"""The loop closed on another plant's recordings: the verdict stands before the truth is looked at."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.loop.close_loop import close_loop, judge_loop
from analysis.loop.tables import loop_json
from benchmarks.analysis import chains
from benchmarks.analysis.shaker_parts import recorded
from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported
from benchmarks.plants.instrument import Instrument
from benchmarks.plants.shaker import BALL_KG, Shaker

BENCH = [sys.executable, "-c", "from bench.cli import main; main()"]
GAMMAS = {1: (0.5, 2.6, 22), 2: (0.2, 1.5, 22), 3: (0.1, 0.8, 22)}


def verdict_on(folder: Path, c: int, seed: int, effect: str = "", strength: str = "strong", **rig: Any) -> Any:
    """The verdict, as JSON, on a recording of the other plant with an effect hidden in it."""
    gammas = np.random.default_rng(seed).permutation(np.round(np.linspace(*GAMMAS[c]), 4))
    hidden = other_plant.hidden_by(effect, strength) if effect else {}
    run = other_plant.Run(c=c, gammas=tuple(gammas.tolist()), seed=seed, hidden=hidden, **rig)
    return loop_json(close_loop([imported(other_plant.simulate(run), other_plant.profile_of(run), folder)]))


def verdict_by_commands(folder: Path, *options: str) -> tuple[dict[str, Any], Path]:
    """The same by the commands, each a process: plant, import and loop share files only; and where the truth lies."""
    plant = [sys.executable, "-m", "benchmarks.plants.other_plant", str(folder), "--shuffle", *options]
    raw, profile, out, report = (folder / name for name in ("recording.csv", "profile.toml", "r.h5", "verdict.json"))
    for command in (
        plant,
        [*BENCH, "import", str(raw), "--profile", str(profile), "--out", str(out)],
        [*BENCH, "close-loop", str(out), "--json", str(report)],
    ):
        subprocess.run(command, check=True, capture_output=True)
    return json.loads(report.read_text(encoding="utf-8")), folder / "truth.json"


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_hidden(tmp_path: Path) -> None:
    """On a clean recording the verdict is that nothing is missing, and the error is the noise."""
    verdict = verdict_on(tmp_path, 1, 31)
    assert verdict["verdict"] == "nothing_missing"
    assert verdict["effects"] == [] and verdict["tie_set"] == []
    assert verdict["after"]["landing_rms_us"] < 1.3 * verdict["noise_floor_us"]


@pytest.mark.slow
@pytest.mark.parametrize(("c", "strength"), [(1, "strong"), (2, "medium")])
def test_a_restitution_that_scatters_is_named_with_its_scatter(tmp_path: Path, c: int, strength: str) -> None:
    """Both are named, the scatter within three of its standard deviations, and landings are at their floor."""
    gammas = np.random.default_rng(41).permutation(np.round(np.linspace(*GAMMAS[c]), 4))
    scatter = other_plant.hidden_by("restitution_scatter", strength)
    hidden = {"restitution.e0": 0.35, **scatter}
    run = other_plant.Run(c=c, gammas=tuple(gammas.tolist()), seed=41, closure_s=1e-4, hidden=hidden)
    verdict = loop_json(close_loop([imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path)]))
    assert verdict["verdict"] == "explained"
    effects = {e["name"]: e["parameters"] for e in verdict["effects"]}
    assert effects.keys() == {"restitution", "restitution_scatter"}
    value, low, high = effects["restitution_scatter"]["sd"].values()
    assert abs(value - scatter[other_plant.SCATTER]) < 3.0 * (high - low) / 3.92
    assert verdict["after"]["landing_rms_us"] < 1.3 * verdict["noise_floor_us"]


@pytest.mark.slow
@pytest.mark.parametrize(("c", "frequency", "jitter_us"), [(2, 40.0, 5.0), (3, 25.0, 0.0), (1, 20.0, 20.0)])
def test_a_drive_of_whole_samples_a_period_hides_nothing(
    tmp_path: Path, c: int, frequency: float, jitter_us: float
) -> None:
    """Where edges fall at the same places between samples in every cycle, their rounding is not taken for an effect."""
    verdict = verdict_on(
        tmp_path, c, 34, frequency_hz=frequency, jitter_s=1e-6 * jitter_us, spikes=True, closure_s=1e-4
    )
    assert verdict["verdict"] == "nothing_missing"
    assert verdict["remainder"]["rms_standardised_residual"] < 1.25


@pytest.mark.slow
def test_a_hidden_friction_is_named_with_its_size(tmp_path: Path) -> None:
    """A friction declared nowhere is named alone, sized within its interval, and brings the error to the noise."""
    hidden = ("--effect", "coulomb_friction", "--strength", "strong")
    verdict, sealed = verdict_by_commands(tmp_path, "--c", "2", *hidden, "--seed", "32")
    assert verdict["verdict"] == "explained"
    assert [e["name"] for e in verdict["effects"]] == ["coulomb_friction"]
    true = json.loads(sealed.read_text(encoding="utf-8"))["hidden"]["coulomb_friction.mu"]
    for found in verdict["effects"][0]["parameters"].values():
        sigma = (found["high"] - found["low"]) / (2 * 1.96)
        assert abs(found["value"] - true) < 3.0 * sigma
        assert found["value"] == pytest.approx(true, rel=0.05)
    assert verdict["after"]["landing_nmad_us"] < 1.4 * verdict["noise_floor_us"]
    assert verdict["before"]["landing_nmad_us"] > 10.0 * verdict["after"]["landing_nmad_us"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "c"), [("accelerometer_lag", 1), ("mains_pickup", 2), ("accelerometer_high_pass", 2)]
)
def test_a_fault_of_the_accelerometer_is_no_doing_of_ball_or_contact(tmp_path: Path, effect: str, c: int) -> None:
    """A reading that is late, one with mains in it, and one behind a high-pass are named as such: no early contact, no
    plate that hums, no late contact."""
    verdict = verdict_on(tmp_path, c, 35, effect, "medium")
    assert verdict["verdict"] == "explained"
    assert [e["name"] for e in verdict["effects"]] == [effect]


@pytest.mark.slow
def test_what_has_no_name_is_not_called_explained(tmp_path: Path) -> None:
    """A pull that sets in above a height is outside the library: something is left, and the verdict says so."""
    verdict = verdict_on(tmp_path, 2, 33, "upper_stop")
    assert verdict["verdict"] == "unexplained"
    assert verdict["remainder"]["p_lack_of_fit"] < 1e-4


@pytest.mark.slow
def test_a_light_table_and_a_late_accelerometer_are_found_together(tmp_path: Path) -> None:
    """A table of 20 kg behind a converter's filter, one tone: both causes have their names and sizes, nothing else."""
    gammas = np.random.default_rng((80041, 7)).permutation(np.round(np.linspace(0.5, 2.6, 22), 4))
    rig = Shaker(table_kg=20.0, gammas=tuple(gammas.tolist()), seed=80041)
    loop = close_loop([recorded(rig, tmp_path)])
    assert loop.verdict == "explained"
    assert {effect.name for effect in loop.selection.effects} == {"table_resonance", "accelerometer_lag"}
    found = {(p.effect, p.parameter): p for p in loop.selection.parameters}
    for name, true in {"mass_ratio": BALL_KG / 20.0, "frequency_hz": 8.0, "damping": 0.7}.items():
        assert found["table_resonance", name].value == pytest.approx(true, rel=0.05)


@pytest.mark.slow
def test_a_friction_that_grows_is_named_with_its_drift(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """By 5 % a second over a short run: cause and drift are named, and linear algebra prints nothing."""
    gammas = np.random.default_rng(8).permutation(np.round(np.linspace(0.7, 1.5, 9), 4))
    hidden = {"coulomb_friction.mu": 0.1, "friction_drift.per_s": 0.05}
    run = other_plant.Run(gammas=tuple(gammas.tolist()), seed=8, jitter_s=5e-6, hidden=hidden, instrument=Instrument())
    loop, _ = judge_loop([imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path)])
    assert loop.verdict == "explained"
    assert [e.name for e in loop.selection.effects] == ["coulomb_friction", "parameter_drift"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [702000, 795004])
def test_mains_on_a_multiple_of_the_forcing_hide_no_friction(tmp_path: Path, seed: int) -> None:
    """Mains in the cable, at the second harmonic or the second tone, are named with the friction, and no third."""
    path, _, truth = chains.recorded(chains.Job("mains with odd harmonics, 10 mV", "friction", "other", seed), tmp_path)
    verdict = loop_json(close_loop([path]))
    assert verdict["verdict"] == "explained"
    assert {e["name"] for e in verdict["effects"]} == {*truth, "mains_pickup"}
