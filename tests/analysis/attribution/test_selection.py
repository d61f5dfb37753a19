"""Attribution on runs with a known cause: named, tied where nobody could tell, left out again where it is idle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from analysis.attribution.candidates import Candidate, candidates_of
from analysis.attribution.chance import ChanceGains
from analysis.attribution.choice import LogScoreDifference, penalised_best
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis, remaining_candidates
from analysis.attribution.selection import SelectionResult, StepwiseSelection, _Round
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import TREND, ParameterId
from analysis.thresholds import FROZEN, MOST_OF_A_STEP_NATS

GAMMAS = (0.5, 1.1, 0.8, 1.3, 0.65, 0.95)
SOME = ("coulomb_friction", "viscous_damping", "quadratic_drag", "local_gravity", "adhesion", "contact_latency")
UP, DOWN, RATE = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down"), ("viscous_damping", "rate_per_s")
STRIBECK = {"mu_kinetic": 0.05, "mu_extra": 0.01, "v_s_mps": 0.05, "exponent": 1.0}
Explain = Callable[..., SelectionResult]


@pytest.fixture
def explain(fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]) -> Explain:
    """Explanation of a short run by a library of six."""

    def explained(truth: dict[ParameterId, float], seed: int, gammas: tuple[float, ...] = GAMMAS) -> SelectionResult:
        model = fly_ramp(truth, seed, gammas=gammas)
        few = [c for c in candidates_of(model) if set(c.names) <= set(SOME)]
        return StepwiseSelection(model, fitter_of(model), library=few).run()

    return explained


@pytest.fixture
def selection_of(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> Callable[..., StepwiseSelection]:
    """The whole selection on a short run."""

    def made(truth: dict[ParameterId, float], seed: int, gammas: tuple[float, ...] = GAMMAS) -> StepwiseSelection:
        model = fly_ramp(truth, seed, gammas=gammas)
        return StepwiseSelection(model, fitter_of(model))

    return made


def test_a_cause_is_named_with_its_size(explain: Explain) -> None:
    """Friction of 0.05 alone: one name, both directions, no companion."""
    found = explain({UP: 0.05, DOWN: 0.05}, 1)
    assert found.best.names == ("coulomb_friction",)
    for key in (UP, DOWN):
        fitted = found.best.fitted
        assert abs(fitted.values[key] - 0.05) < 4.0 * fitted.sigma(key)
    assert found.ties[0] is not found.before
    assert {names for names, _ in found.tried} >= {("coulomb_friction",)}


def test_noise_is_given_no_name(explain: Explain) -> None:
    """Nothing missing: the best is the declared model itself, and there is no tie set."""
    found = explain({}, 2)
    assert found.best is found.before
    assert found.ties == ()


def test_what_leaves_more_than_noise_neither_ties_with_nor_replaces_what_leaves_none(
    selection_of: Callable[..., StepwiseSelection],
) -> None:
    """Friction explains the run: drag is no rival, however well its steps do; beside drag as the best, a second is."""
    selection = selection_of({UP: 0.05, DOWN: 0.05}, 1)
    nothing, friction = selection.declared(), added(selection, named(selection, "coulomb_friction"))
    key = ("quadratic_drag", "k_per_m")
    candidate = Candidate(("quadratic_drag",), (key,))
    fitted = selection.refits.converged((candidate,), nothing.whitener, (key,), {key: 0.5})
    drag = replace(fitted, losses=friction.losses)
    assert friction.noise_like(1.25) and not drag.noise_like(1.25)
    assert selection._ties(nothing, friction, [friction, drag]) == (friction,)
    as_good = replace(friction, candidates=(candidate,))
    assert selection._ties(nothing, friction, [friction, as_good]) == (friction, as_good)
    assert selection._ties(nothing, drag, [drag, friction]) == (drag, friction)
    assert selection.pruning._as_good(friction, as_good) and selection.pruning._as_good(drag, friction)
    assert not selection.pruning._as_good(friction, drag)


@pytest.mark.parametrize("strained", [True, False])
def test_a_further_cause_is_sought_while_a_calibration_stands_at_its_bound(
    fly_ramp: Callable[..., ForwardModel],
    fitter_of: Callable[[ForwardModel], Fitter],
    monkeypatch: pytest.MonkeyPatch,
    strained: bool,
) -> None:
    """Friction and a late accelerometer, whatever is left taken for noise: the lag is named where it strains one."""
    model = fly_ramp({UP: 0.05, DOWN: 0.05, ("accelerometer_lag", "delay_s"): 5e-4}, 1)
    few = [c for c in candidates_of(model) if set(c.names) <= {"coulomb_friction", "accelerometer_lag"}]
    monkeypatch.setattr(Hypothesis, "noise_like", lambda *_: True)
    monkeypatch.setattr(Hypothesis, "strained", property(lambda x: strained and len(x.names) < 2))
    best = StepwiseSelection(model, fitter_of(model), library=few).run().best
    assert len(best.names) == 1 + strained


def test_what_did_as_well_is_followed_too_where_a_calibration_stands_at_its_bound(
    selection_of: Callable[..., StepwiseSelection], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rival with the same loss: with the cause that the calibration plays, it may do better."""
    selection = selection_of({UP: 0.05, DOWN: 0.05}, 1)
    friction = added(selection, named(selection, "coulomb_friction"))
    assert not friction.strained
    rival = replace(friction, candidates=(Candidate(("quadratic_drag",), (("quadratic_drag", "k_per_m"),)),))
    assert selection._rival(friction, [friction, rival]) is None
    monkeypatch.setattr(Hypothesis, "strained", property(lambda x: x is friction))
    assert selection._rival(friction, [friction, rival]) is rival


def test_a_first_choice_that_leaves_more_than_noise_gives_way_to_another(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A choice misled to damping, with one effect allowed: friction is followed as well, and what is taken says so."""
    model = fly_ramp({UP: 0.05, DOWN: 0.05}, 1, gammas=GAMMAS)
    few = [c for c in candidates_of(model) if set(c.names) <= {"coulomb_friction", "viscous_damping"}]
    selection = StepwiseSelection(model, fitter_of(model), replace(FROZEN, most_effects=1), library=few)
    choose = selection.judge.choose

    def misled(best: Hypothesis, found: Sequence[Hypothesis], *rest: Any) -> Hypothesis | None:
        return next((x for x in found if x.names == ("viscous_damping",)), None) or choose(best, found, *rest)

    monkeypatch.setattr(selection.judge, "choose", misled)
    result = selection.run()
    assert result.best.names == ("coulomb_friction",)
    assert result.rounds[0].startswith("viscous_damping, chosen first, leaves more than noise")
    assert {names for names, _ in result.tried} >= {("viscous_damping",), ("coulomb_friction",)}


def test_a_cause_in_the_instruments_takes_no_place_from_those_of_the_ball(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """With one effect on the ball allowed, a late accelerometer is named with a friction."""
    model = fly_ramp({UP: 0.05, DOWN: 0.05, ("accelerometer_lag", "delay_s"): 5e-4}, 1)
    few = [
        c for c in candidates_of(model) if set(c.names) <= {"coulomb_friction", "accelerometer_lag", "viscous_damping"}
    ]
    result = StepwiseSelection(model, fitter_of(model), replace(FROZEN, most_effects=1), library=few).run()
    assert set(result.best.names) == {"coulomb_friction", "accelerometer_lag"}


def test_a_first_choice_that_the_verdict_lets_pass_is_followed_alone(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Uncertainties said too small, as a quiet rig's are: scatter without structure sends nobody another way."""
    model = fly_ramp({UP: 0.05, DOWN: 0.05}, 1, gammas=GAMMAS)
    few = [c for c in candidates_of(model) if set(c.names) <= {"coulomb_friction", "viscous_damping"}]
    selection = StepwiseSelection(model, fitter_of(model), library=few)
    monkeypatch.setattr("analysis.attribution.hypothesis.rms_standardised", lambda *_: 1.5)
    monkeypatch.setattr("analysis.residuals.lack_of_fit.rms_standardised", lambda *_: 1.5)
    ways, follow = list[SelectionResult](), selection._followed

    def counted(before: Hypothesis, found: list[Hypothesis]) -> tuple[SelectionResult, tuple[str, ...]]:
        result, first = follow(before, found)
        ways.append(result)
        return result, first

    monkeypatch.setattr(selection, "_followed", counted)
    result = selection.run()
    assert result.best.names == ("coulomb_friction",)
    assert ways == [result]
    assert result.best.passes(FROZEN) and not result.best.noise_like(FROZEN.lack_ratio)
    assert not result.before.passes(FROZEN)


@pytest.mark.parametrize("gain_nats", [10.0, 100.0])
def test_a_simpler_form_of_a_weak_effect_passes_the_tests_itself(
    selection_of: Callable[..., StepwiseSelection], monkeypatch: pytest.MonkeyPatch, gain_nats: float
) -> None:
    """A form is accepted and gives way to a simpler one that does nothing: a gain of 10 nats leaves no name, 100 do."""
    selection = selection_of({UP: 0.05, DOWN: 0.05}, 1)
    nothing, friction = selection.declared(), added(selection, named(selection, "coulomb_friction"))
    share = gain_nats / len(nothing.losses) / np.count_nonzero(selection.judge.train)
    form = replace(friction, losses={k: x - share for k, x in nothing.losses.items()})
    idle = replace(friction, losses=nothing.losses)
    monkeypatch.setattr(selection.pruning, "simplified", lambda *_: idle)
    monkeypatch.setattr(selection.judge, "choose", lambda *_: form)
    result, _ = selection._followed(nothing, [form])
    refused = any(
        line.startswith("step back: that simpler form is refused (too small a gain") for line in result.rounds
    )
    assert refused == (gain_nats < FROZEN.next_effect_nats) == (result.best is result.before)


def test_a_simpler_form_is_tried_when_all_causes_are_named(
    selection_of: Callable[..., StepwiseSelection], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damping is chosen first and leaves more than noise; friction follows; only both together are looked at again."""
    selection, seen = selection_of({UP: 0.05, DOWN: 0.05}, 1), []
    in_turn = ("viscous_damping", "coulomb_friction")
    selection.library = [named(selection, name) for name in in_turn]

    def chosen(best: Hypothesis, found: Sequence[Hypothesis], *_: object) -> Hypothesis | None:
        return next((x for x in found if x.names == in_turn[: len(best.names) + 1] != best.names), None)

    monkeypatch.setattr(selection.judge, "choose", chosen)
    monkeypatch.setattr(selection.pruning, "without_idle", lambda x, *_: x)
    monkeypatch.setattr(selection.pruning, "simplified", lambda x, *_: seen.append(x.names) or x)
    nothing = selection.declared()
    selection._followed(nothing, [added(selection, selection.library[0])])
    assert seen == [in_turn]


def test_where_every_cause_is_taken_back_the_declared_model_stands(
    selection_of: Callable[..., StepwiseSelection], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A weak spring gains, becomes a gravity, and that holds zero: nothing is named, and no tie is of nothing."""
    selection = selection_of({UP: 0.05, DOWN: 0.05}, 1)
    selection.library = [named(selection, "coulomb_friction")]
    monkeypatch.setattr(selection.pruning, "without_null", lambda x, _: replace(x, candidates=()))
    found = selection.run()
    assert found.best is found.before and found.ties == ()


@pytest.mark.slow
def test_two_causes_are_both_named(explain: Explain) -> None:
    """Damping with a plate that holds the ball: neither can stand in for the other."""
    found = explain({RATE: 1.5, ("adhesion", "a_mps2"): 1.5}, 3, tuple(np.linspace(0.35, 1.35, 14)))
    assert set(found.best.names) == {"viscous_damping", "adhesion"}


def test_an_idle_companion_is_left_out_again(selection_of: Callable[..., StepwiseSelection]) -> None:
    """Drag that was added before friction explained everything goes when it is looked at again."""
    selection = selection_of({UP: 0.05, DOWN: 0.05}, 4)
    drag = Candidate(("quadratic_drag",), (("quadratic_drag", "k_per_m"),), ({("quadratic_drag", "k_per_m"): 0.5},))
    friction = Candidate(("coulomb_friction",), (UP, DOWN), ({UP: 0.05, DOWN: 0.05},))
    free, start = (*drag.free, *friction.free), {**drag.starts[0], **friction.starts[0]}
    both = selection.refits.converged((drag, friction), Whitener.of(selection.model, start), free, start)
    rounds: list[str] = []
    assert selection.pruning.without_idle(both, both.candidates, rounds).names == ("coulomb_friction",)
    assert rounds == ["step back: quadratic_drag is no longer needed"]


def test_a_cause_that_only_a_fuller_form_needed_goes_with_it(selection_of: Callable[..., StepwiseSelection]) -> None:
    """A magnet of long range with a gravity is a spring: once that is found, no gravity is named."""
    spring, magnet, reach = (("position_force", q) for q in ("spring_per_s2", "magnet_mps2", "range_m"))
    gravity = ("local_gravity", "excess_mps2")
    selection = selection_of({spring: 40.0}, 4)
    both = (
        Candidate(("position_force",), (magnet, reach), ({magnet: -1.5, reach: 0.035},)),
        Candidate(("local_gravity",), (gravity,), ({gravity: 1.5},)),
    )
    start = {magnet: -1.5, reach: 0.035, gravity: 1.5}
    best = selection.refits.converged(both, Whitener.of(selection.model, start), (magnet, reach, gravity), start)
    last = _Round(best, [], LogScoreDifference(1e3, 1.0, 1e3, 1.0), 1, ChanceGains(best, [], np.random.default_rng(1)))
    rounds: list[str] = []
    kept, _ = selection._simplest(best, [], last, rounds)
    assert kept.free == (spring,)
    assert rounds == [
        "step back: a simpler position_force does as well",
        "step back: local_gravity is no longer needed",
    ]


@pytest.mark.parametrize("pull", [0.0, 0.4])
def test_what_was_stepped_back_to_gets_the_fuller_form_that_it_needs(
    selection_of: Callable[..., StepwiseSelection], pull: float
) -> None:
    """A spring with a magnet, and a damping: the magnet is found where there is one, and not else."""
    spring, magnet, reach = (("position_force", q) for q in ("spring_per_s2", "magnet_mps2", "range_m"))
    selection = selection_of({spring: 20.0, magnet: pull, reach: 2e-3, RATE: 0.5}, 4)
    alone = next(c for c in selection.library if c.free == (spring,))
    best, rounds = added(selection, alone, named(selection, "viscous_damping")), list[str]()
    found = selection._fullest(best, rounds)
    assert found.names == ("viscous_damping", "position_force") if pull else found is best
    assert len(rounds) == (pull > 0.0) and (magnet in found.free) == (pull > 0.0)
    assert abs(found.fitted.values[spring] - 20.0) < 3.0 * found.fitted.sigma(spring)


def test_a_special_case_takes_the_place_of_what_it_is_one_of(selection_of: Callable[..., StepwiseSelection]) -> None:
    """Stribeck friction beside adhesion, where friction is as strong at any speed: plain friction does as well."""
    start = {UP: 0.05, DOWN: 0.05, ("adhesion", "a_mps2"): 1.5}
    selection = selection_of(start, 6, tuple(np.linspace(0.35, 1.35, 14)))
    stribeck = {("stribeck_friction", k): v for k, v in STRIBECK.items()} | {("adhesion", "a_mps2"): 1.5}
    candidates = tuple(named(selection, name) for name in ("stribeck_friction", "adhesion"))
    both = selection.refits.converged(candidates, Whitener.of(selection.model, stribeck), tuple(stribeck), stribeck)
    rounds: list[str] = []
    assert selection.pruning.simplified(both, selection.library, rounds).names == ("coulomb_friction", "adhesion")
    assert rounds == ["step back: a simpler coulomb_friction does as well"]


def test_a_special_case_drifts_as_the_fuller_form_did(selection_of: Callable[..., StepwiseSelection]) -> None:
    """Plain friction that doubles during the run, fitted as a Stribeck friction with a drift: both keep their drift."""
    drift = {(name, q + TREND): 0.06 for name, q in (UP, DOWN)}
    selection = selection_of({UP: 0.1, DOWN: 0.1, **drift}, 5, (*GAMMAS, 1.2, 0.75))
    stribeck, kinetic = named(selection, "stribeck_friction"), ("stribeck_friction", "mu_kinetic")
    trend = Candidate((kinetic[0], "parameter_drift"), ((kinetic[0], kinetic[1] + TREND),), ({},))
    start = {("stribeck_friction", k): v for k, v in STRIBECK.items()} | {kinetic: 0.1, trend.free[0]: 0.06}
    both = selection.refits.converged((stribeck, trend), Whitener.of(selection.model, start), tuple(start), start)
    plain = selection.pruning.simplified(both, selection.library, [])
    assert plain.names == ("coulomb_friction", "parameter_drift")
    assert set(plain.free) == {UP, DOWN, *drift}
    assert all(plain.fitted.values[key] == pytest.approx(0.06, abs=0.005) for key in drift)


def test_a_richer_form_gives_way_to_its_special_case(selection_of: Callable[..., StepwiseSelection]) -> None:
    """Stribeck friction is chosen although plain friction is all there is: the name is that of plain friction."""
    selection = selection_of({UP: 0.15, DOWN: 0.15}, 6)
    stribeck = added(selection, named(selection, "stribeck_friction"))
    rounds: list[str] = []
    assert selection.pruning.simplified(stribeck, selection.library, rounds).names == ("coulomb_friction",)
    assert rounds == ["step back: a simpler coulomb_friction does as well"]


def test_a_special_case_is_looked_at_again_beside_the_fuller_form(
    selection_of: Callable[..., StepwiseSelection],
) -> None:
    """Stribeck friction won a round: the round's better fit of plain friction gets its second causes as well."""
    selection = selection_of({}, 2)
    nothing = selection.declared()
    stribeck, plain, drag = (
        replace(nothing, candidates=(named(selection, name),))
        for name in ("stribeck_friction", "coulomb_friction", "quadratic_drag")
    )
    worse = replace(plain, losses={k: x + 1.0 for k, x in plain.losses.items()})
    assert selection._special_case(stribeck, [drag, worse, plain, stribeck]) is plain
    assert selection._special_case(plain, [drag, plain, stribeck]) is None
    offered = remaining_candidates(selection.library, plain, stribeck.names)
    assert "quadratic_drag" in {c.names[0] for c in offered}
    assert not {"stribeck_friction", "coulomb_friction"} & {c.names[0] for c in offered if len(c.names) == 1}


@pytest.mark.parametrize("offered", ["coulomb_friction", "quadratic_drag"])
def test_nothing_is_looked_for_from_afar_once_it_is_found(
    selection_of: Callable[..., StepwiseSelection], monkeypatch: pytest.MonkeyPatch, offered: str
) -> None:
    """Landings are lost to friction: a fit from nearby that leaves noise ends the search, drag alone does not."""
    selection = selection_of({UP: 0.15, DOWN: 0.15}, 6)
    asked: list[str] = []

    def from_afar(*_: object) -> list[Hypothesis]:
        asked.append("afar")
        return []

    monkeypatch.setattr(selection.proposals, "_from_afar", from_afar)
    nothing = selection.declared()
    assert nothing.whitener.lost
    selection.proposals.round(nothing, [named(selection, offered)], lambda *_: None)
    assert bool(asked) is (offered == "quadratic_drag")


def test_a_fuller_form_of_what_is_named_stays_on_offer(selection_of: Callable[..., StepwiseSelection]) -> None:
    """Restitution without its slope is named: the slope may follow, what else is named may not again."""
    selection = selection_of({}, 2)
    bare = min((c for c in selection.library if c.names == ("restitution",)), key=lambda c: len(c.free))
    drag = named(selection, "quadratic_drag")
    best = replace(selection.declared(), candidates=(drag, bare))
    offered = remaining_candidates(selection.library, best)
    assert any(c.names == ("restitution",) and set(bare.free) < set(c.free) for c in offered)
    assert bare not in offered and drag not in offered


def named(selection: StepwiseSelection, name: str) -> Candidate:
    """The first candidate of a name."""
    return next(c for c in selection.library if c.names == (name,))


def added(selection: StepwiseSelection, *candidates: Candidate) -> Hypothesis:
    """The declared model with candidates added one after the other, where they change anything."""
    best = selection.declared()
    for candidate in candidates:
        best = selection.proposals.add(best, candidate) or best
    return best


def test_a_few_steps_that_gain_much_do_not_hide_the_many_that_gain_little() -> None:
    """One step of 900 nats makes the sum doubtful by its own spread; capped, all the others speak."""
    train = np.ones(16, dtype=bool)
    worse, better = np.full(16, 5.0), np.zeros(16)
    worse[3] = 900.0
    gain = LogScoreDifference.of(worse, better, train)
    assert gain.gain == pytest.approx(975.0)
    assert gain.gain < 2.0 * gain.error
    assert gain.clipped == pytest.approx(75.0 + MOST_OF_A_STEP_NATS)
    assert gain.exceeds(12.0, 2.0)


def test_what_gains_in_one_step_and_loses_in_the_next_is_no_gain() -> None:
    """Differences of either sign: the sum is positive, its error larger."""
    rng = np.random.default_rng(0)
    d = 10.0 * rng.standard_normal(16)
    d += (15.0 - d.sum()) / 16
    assert not LogScoreDifference.of(d, np.zeros(16), np.ones(16, dtype=bool)).exceeds(12.0, 2.0)


def test_a_lead_in_some_steps_outweighs_a_parameter() -> None:
    """A parameter more is worth 25 nats in two steps, and not 3: the price of one is 4."""
    train, none = np.ones(6, dtype=bool), np.zeros(6)
    far, hardly = np.array([12.0, 13.0, 0.0, 0.0, 0.0, 0.0]), np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert penalised_best(none, [far, none], [4.0, 8.0], train) == 1
    assert penalised_best(none, [hardly, none], [4.0, 8.0], train) == 0


def test_one_step_alone_outweighs_no_more_than_itself() -> None:
    """A step that loses 300 nats to a hidden bounce, and twenty that gain one each: these decide."""
    train, top = np.ones(21, dtype=bool), np.zeros(21)
    bounced = np.concatenate([[300.0], np.full(20, -1.0)])
    assert penalised_best(top, [top, bounced], [4.0, 4.0], train) == 1


def test_no_second_cause_is_looked_for_in_noise(explain: Explain) -> None:
    """Friction alone explains the run: the search ends there, and says why."""
    found = explain({UP: 0.05, DOWN: 0.05}, 1)
    assert found.rounds[-1] == "round 2: what is left is no more than noise"


def test_a_drift_is_tried_beside_a_strong_cause_at_once(explain: Explain) -> None:
    """Friction that grows by a factor of four during the run: named with its drift in the first round, nothing else."""
    drift = {(name, q + TREND): 0.12 for name, q in (UP, DOWN)}
    found = explain({UP: 0.1, DOWN: 0.1, **drift}, 5, (*GAMMAS, 1.2, 0.75, 1.0, 0.55))
    assert found.best.names == ("coulomb_friction", "parameter_drift")
    assert found.rounds[0].startswith("round 1: coulomb_friction + parameter_drift gains")
    assert ("coulomb_friction", "parameter_drift") in [names for names, _ in found.tried]
    assert [x.names for x in found.earlier] == [(), ("coulomb_friction",)]


def test_a_cause_whose_interval_holds_nothing_in_the_end_goes(selection_of: Callable[..., StepwiseSelection]) -> None:
    """Friction and a drag of no size, both chosen: the drag names nothing."""
    selection = selection_of({UP: 0.05, DOWN: 0.05}, 4)
    both = added(selection, named(selection, "coulomb_friction"))
    drag = Candidate(("quadratic_drag",), (("quadratic_drag", "k_per_m"),))
    free = (*both.free, *drag.free)
    both = selection.refits.converged((*both.candidates, drag), both.whitener, free, both.fitted.values)
    rounds: list[str] = []
    assert selection.pruning.without_null(both, rounds).names == ("coulomb_friction",)
    assert rounds == ["step back: the 95 % intervals of quadratic_drag hold the values of no effect"]


def test_a_cause_that_moves_two_calibrations_gives_way_to_one_of_them(
    selection_of: Callable[..., StepwiseSelection],
) -> None:
    """A sensor that reads 2.5 % low, chosen as a weaker gravity with calibrations at their limits, is named."""
    gain = ("accelerometer_gain", "relative")
    selection = selection_of({gain: -0.025}, 3)
    gravity = added(selection, named(selection, "local_gravity"))
    assert gravity.fitted.moved_calibrations(2.0) >= {gain}
    rounds: list[str] = []
    chosen, rivals = selection._exchanged(gravity, rounds, {}, retried=False)
    assert chosen.names == ("accelerometer_gain",) and [x.names for x in rivals] == [("local_gravity",)]
    assert abs(chosen.fitted.values[gain] + 0.025) < 4.0 * chosen.fitted.sigma(gain)
    assert rounds == ["accelerometer_gain in place of local_gravity: as good or better"]


def test_the_last_cause_is_tried_again_where_others_were_simplified_since(
    selection_of: Callable[..., StepwiseSelection],
) -> None:
    """A late accelerometer beside a friction was called a sideways mode, which a fuller friction had made cheaper."""
    lag = ("accelerometer_lag", "delay_s")
    selection = selection_of({UP: 0.05, DOWN: 0.05, lag: 5e-4}, 1)
    friction, late, mode = (named(selection, name) for name in ("coulomb_friction", lag[0], "accelerometer_cross_axis"))
    sizes, before = {UP: 0.05, DOWN: 0.05}, Whitener.of(selection.model, {UP: 0.05, DOWN: 0.05, lag: 5e-4})
    one, other = (
        selection.refits.converged((friction, c), before, (*friction.free, *c.free), {**sizes, **start})
        for c, start in ((mode, {mode.free[0]: -5e-4, mode.free[1]: 200.0}), (late, {lag: 5e-4}))
    )
    assert selection.judge.tied(one, other) and one.numbers > other.numbers
    for retried in (False, True):
        chosen, _ = selection._exchanged(one, [], {mode.names[0]: [other, other]}, retried=retried)
        assert chosen.names == ("coulomb_friction", (late if retried else mode).names[0])


def test_a_candidate_whose_fit_is_not_finite_is_left_out_by_name(
    fly_ramp: Callable[..., ForwardModel],
    fitter_of: Callable[[ForwardModel], Fitter],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """A model that diverges under one candidate costs that candidate alone: the cause is named, the other noted."""
    model = fly_ramp({UP: 0.05, DOWN: 0.05}, 0, gammas=GAMMAS)
    residuals = ForwardModel.residuals

    def diverging(self: ForwardModel, values: Any, rows: Any = None, wanted: Any = None) -> Any:
        r = residuals(self, values, rows, wanted)
        off = any(name == "viscous_damping" and v != 0.0 for (name, _), v in values.items())
        return replace(r, plate=np.full_like(r.plate, np.nan)) if off else r

    monkeypatch.setattr(ForwardModel, "residuals", diverging)
    few = [c for c in candidates_of(model) if set(c.names) <= {"coulomb_friction", "viscous_damping"}]
    starting = [replace(c, starts=({RATE: 1.0},)) if c.names == ("viscous_damping",) else c for c in few]
    found = StepwiseSelection(model, fitter_of(model), library=starting).run()
    assert found.best.names == ("coulomb_friction",)
    assert "viscous_damping left out: what it predicts is not finite" in found.rounds
    assert capfd.readouterr() == ("", "")


LAG, COUPLING = ("accelerometer_lag", "delay_s"), ("accelerometer_high_pass", "corner_hz")
SIDEWAYS = ("accelerometer_cross_axis", "lead_s")


@pytest.fixture
def instruments(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> Callable[[dict[ParameterId, float]], StepwiseSelection]:
    """The selection among three instruments on a run of twelve steps."""

    def made(truth: dict[ParameterId, float]) -> StepwiseSelection:
        model = fly_ramp(truth, 1, gammas=(*GAMMAS, *GAMMAS))
        few = [c for c in candidates_of(model) if set(c.names) <= {LAG[0], COUPLING[0], SIDEWAYS[0]}]
        return StepwiseSelection(model, fitter_of(model), library=few)

    return made


def test_a_sideways_mode_goes_where_other_instruments_explain_with_as_few_numbers(
    instruments: Callable[[dict[ParameterId, float]], StepwiseSelection], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A coupling with a filter, found with a mode of the table besides, is named without it."""
    selection, chosen = instruments({COUPLING: 0.6, LAG: 1e-4}), StepwiseSelection._chosen
    found, mode = selection._chosen(), named(selection, SIDEWAYS[0])
    options, free = (*found.best.candidates, mode), (*found.best.free, *mode.free)
    best = selection.refits.converged(options, found.best.whitener, free, found.best.fitted.values)
    assert best.passes(FROZEN) and len(best.names) == 3
    more = replace(found, best=best)
    monkeypatch.setattr(StepwiseSelection, "_chosen", lambda own: more if own is selection else chosen(own))
    assert set(selection.run().best.names) == {COUPLING[0], LAG[0]}


def test_a_sideways_mode_that_nothing_else_explains_is_named(
    instruments: Callable[[dict[ParameterId, float]], StepwiseSelection],
) -> None:
    """Above both tones it leads the faster one more, as no coupling and no filter do."""
    assert instruments({SIDEWAYS: 3e-5}).run().best.names == (SIDEWAYS[0],)
