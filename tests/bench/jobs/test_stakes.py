"""A verdict stakes a prediction on a later run: how it is written, read, met, and missed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

import shakerbench as sb
from analysis.explore.stake import Outcome, StepMet, held_against, staked, steps_of, with_outcome
from analysis.loop.close_loop import fit_loop
from analysis.loop.result import ClosedLoop, load_verdict
from analysis.residuals.observations import observations_from
from bench.cli import app
from bench.jobs.blocks import Aims, Chosen, by_person, offers, outcome_of, read_stake, stake_toml
from bench.profiles.edit import with_values
from bench.profiles.find import load
from daq.setup.errors import InputError
from daq.setup.setup import Stake, stake_in
from rig.profile import parse_profile
from rig.programme.ramp import NextSteps

BRIEF = {"ramp.gamma": [0.6, 0.8], "ramp.settle_cycles": 2, "ramp.hold_cycles": 8}
TEXT = with_values(load("simulated")[1], BRIEF, "p")
GAMMAS = [0.6, 0.75, 0.9, 1.05, 1.2, 1.35, 1.5, 1.65, 1.8, 1.95]


def a_stake(written: str = "2026-01-02T03:04:05Z", gammas: tuple[float, ...] = (0.6, 0.8)) -> Stake:
    """Friction staked on two gammas."""
    friction = {"effect": "coulomb_friction", "cause": True, "value": 0.12}
    step = {"within_us": 5.0, "rival_us": 90.5, "declared_us": 1e-7, "flight_ms": 30.0}
    return Stake.model_validate({
        "named": ("coulomb_friction",), "rival": (), "nats": 50.0, "chance": 0.01, "software": 'x "y"',
        "written": written, "recordings": ("a.h5",), "covariance": ((1e-4, 0.0), (0.0, 2e-4)),
        "parameters": tuple({**friction, "parameter": f"mu_{way}"} for way in ("up", "down")),
        "steps": tuple({**step, "gamma": g} for g in gammas),
    })  # fmt: skip


def staked_text(**changes: object) -> str:
    """The brief ramp's profile with that stake."""
    return TEXT + "\n" + stake_toml(a_stake(**changes))


def test_a_stake_is_a_profile_that_can_be_driven_and_read_again(tmp_path: Path) -> None:
    """What is written is read as it was, with its ramp around it; steps that a person changes drop it."""
    text = staked_text()
    assert stake_in(text, "stake.toml") == a_stake() == parse_profile(text, "stake.toml").stake
    lost = a_stake().model_copy(update={"steps": (a_stake().steps[0].model_copy(update={"rival_us": None}),)})
    assert stake_in(stake_toml(lost), "stake.toml") == lost
    (tmp_path / "stake.toml").write_text(text, encoding="utf-8")
    assert "coulomb_friction is staked on it" in called(f"plan {tmp_path}/stake.toml")
    assert stake_in(by_person(Chosen(text, 1.0, "staked"), NextSteps((0.7, 0.9))).text, "block") is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  [0.0001, 0.0],\n", "", r"stake: covariance: expected 2 rows of 2 numbers"),
        ("nats = 50.0", "nat = 50.0", r"stake.nat: unknown key; did you mean nats\?"),
        ("within_us = 5.0", "within_us = 0.0", r"stake.steps\[0\].within_us: wanted a number greater than 0"),
        ("value = 0.12", 'value = "much"', r"stake.parameters\[0\].value: wanted a number"),
        ("[stake]", "[stakes]", r"stakes: unknown key; did you mean stake\?"),
    ],
)
def test_a_mistake_in_a_stake_is_named_with_file_and_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    """The file, the key and what was wanted are in the message."""
    path = tmp_path / "stake.toml"
    path.write_text(staked_text().replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=words) as refused:
        read_stake(path)
    assert str(path) in str(refused.value)


def test_a_profile_without_a_stake_is_no_prediction(tmp_path: Path) -> None:
    """It says which file was wanted."""
    path = tmp_path / "p.toml"
    path.write_text(TEXT, encoding="utf-8")
    with pytest.raises(InputError, match=r"p.toml: \[stake\]: missing; wanted a file that bench close-loop --stake"):
        read_stake(path)


def test_only_a_later_run_of_the_same_rig_is_held_against_a_stake(tmp_path: Path) -> None:
    """Another ball, other declared effects, an earlier run and one without the staked steps are refused."""
    heavy, rod = tmp_path / "heavy.h5", tmp_path / "rod.h5"
    sb.run(sb.load_profile("simulated").with_values({**BRIEF, "ball.mass_kg": 0.3}), heavy, seed=1)
    declared = {**BRIEF, "declared.coulomb_friction.mu_up": 0.1}
    sb.run(sb.load_profile("simulated").with_values(declared), rod, seed=1)
    own = tmp_path / "own.h5"
    sb.run(sb.load_profile("simulated").with_values(BRIEF), own, seed=1)
    for path, words in ((heavy, "ball.mass_kg = 0.3, the stake 0.2492"), (rod, "declared.coulomb_friction")):
        with pytest.raises(InputError, match=words):
            outcome_of(a_stake(), staked_text(), path)
    with pytest.raises(InputError, match="only a later run can meet it"):
        outcome_of(a_stake(written="2999-01-01T00:00:00Z"), staked_text(), own)
    with pytest.raises(InputError, match=r"own.h5: has no step at the staked gamma 1.7; drive"):
        outcome_of(a_stake(gammas=(0.6, 1.7)), staked_text(), own)


def test_a_stake_that_is_missed_withdraws_the_verdict(closed_loop: ClosedLoop) -> None:
    """One step outside its interval is enough, and is said once; a stake that is met is a note."""
    step = a_stake().steps[0]
    met = Outcome((StepMet(step, 3.0, 5.0, 20),), 1.0, 1.0, True, True)
    missed = replace(met, steps=(*met.steps, StepMet(step, -7.0, 5.0, 20)))
    assert not replace(met, steps=(StepMet(step, float("nan"), float("nan"), 0),)).met  # the ball did not fly there
    stands = with_outcome(closed_loop, met, "next.h5")
    assert (stands.verdict, stands.failed) == (closed_loop.verdict, closed_loop.failed)
    assert stands.notes[-1] == "the prediction staked on next.h5: met"
    gone = with_outcome(with_outcome(closed_loop, missed, "next.h5"), missed, "next.h5")
    assert gone.verdict == "unexplained" and [f.test for f in gone.failed] == ["stake"]
    assert len(gone.notes) == len(closed_loop.notes) + 1 and "the verdict is withdrawn" in gone.notes[-1]


@pytest.fixture(scope="module")
def friction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a ramp of a rig with dry friction."""
    folder = tmp_path_factory.mktemp("staked")
    ramp = {"ramp.gamma": GAMMAS, "ramp.settle_cycles": 10, "ramp.hold_cycles": 30}
    sb.run(sb.load_profile("simulated").with_values(ramp), folder / "r.h5", scenario="friction", seed=3)
    return folder


def called(words: str) -> str:
    """Standard output of a command that succeeds."""
    result = CliRunner().invoke(app, words.split(" "))
    assert result.exit_code == 0, result.output
    return str(result.stdout)


@pytest.mark.slow
def test_a_right_verdict_meets_its_stake_and_another_rig_misses_it(friction: Path) -> None:
    """The stake is driven as a profile; the same rig meets it, one that hides something else withdraws the verdict."""
    stake, loop = friction / "stake.toml", friction / "r.loop"
    assert "coulomb_friction is staked on it" in called(f"close-loop {friction}/r.h5 --stake {stake}")
    staked_on = set(parse_profile(stake.read_text("utf-8")).ramp.gammas())
    for name, met in (("friction", True), ("bouncy", False)):
        called(f"ramp {stake} --scenario {name} --seed 40 --out {friction}/{name}.h5 --json -")
        answer = json.loads(called(f"stake {stake} {friction}/{name}.h5 --json -"))
        assert answer["met"] is met, answer
        assert {s["gamma"] for s in answer["steps"]} <= staked_on
        assert load_verdict(loop).verdict == ("explained" if met else "unexplained")


@pytest.mark.slow
def test_a_wrong_verdict_misses_its_stake(friction: Path) -> None:
    """A force with height, named in place of the friction, predicts a forcing that was never driven wrongly."""
    from analysis.explore.stake import runner_up

    _, fitted = fit_loop([friction / "r.h5"])
    found, text = fitted.selection, with_values(load("simulated")[1], {}, "p")
    (wrong,) = runner_up(found)
    assert wrong.names != ("coulomb_friction",)
    chosen = staked(
        replace(fitted, selection=replace(found, best=wrong, ties=(wrong,))),
        offers(text, Aims(60.0)),
        4,
        ("x", "y"),
        (),
    )
    assert chosen is not None
    block, stake = chosen
    assert stake.named == wrong.names and stake.rival == ("coulomb_friction",)
    forcing, out = block.option.setup.forcing, friction / "wrong.h5"
    ramp = {
        "forcing.ratio": forcing.ratio, "ramp.gamma": list(block.gammas), "ramp.hold_cycles": 14,
        "ramp.order": "up" if block.option.rising else "down",
    }  # fmt: skip
    sb.run(sb.load_profile("simulated").with_values(ramp), out, scenario="friction", seed=41)
    outcome = held_against(stake, observations_from([out]), steps_of(stake, out))
    assert not outcome.met and "the verdict is withdrawn" in outcome.words
