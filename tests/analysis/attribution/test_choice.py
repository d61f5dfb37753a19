"""Judgement by held-out steps: rules of choice, and a reason for every candidate that gains and does not stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from analysis.attribution import hypothesis
from analysis.attribution.candidates import Candidate, Prior
from analysis.attribution.chance import ChanceGains
from analysis.attribution.choice import Judge, LogScoreDifference, chance_refusal, gain_refusal, required_gain, tied
from analysis.attribution.fit import Fitted, Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.linear_algebra import bounded_step
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.thresholds import FROZEN
from kernels.arrays import Floats

STEPS = 16
RATE = ("viscous_damping", "rate_per_s")


@pytest.fixture(scope="module")
def fit_of(fly_ramp: Callable[..., ForwardModel]) -> Callable[..., Fitted]:
    """A fit of damping to a run of four steps: with damping or without, and with plate data scattered more or less."""

    def made(*, sized: bool = True, scatter: float = 1.0) -> Fitted:
        model = fly_ramp({RATE: 2.0 * sized}, 2, gammas=(0.5, 0.6, 0.7, 0.8))
        data = model.observations.plate
        model = ForwardModel(replace(model.observations, plate=replace(data, sigma=data.sigma / scatter)), {})
        whitener = Whitener.of(model, {RATE: 2.0 * sized})
        return Fitter(model, {}, np.ones(4, dtype=bool)).fit(whitener, (RATE,), {RATE: 2.0 * sized})

    return made


@pytest.fixture
def explanation(fit_of: Callable[..., Fitted]) -> Callable[..., Hypothesis]:
    """A candidate with given losses by step; ``sized``: its damping differs from none."""

    def made(name: str, events: Floats, plate: Floats | None = None, **how: float) -> Hypothesis:
        losses = {"events": events, "plate": np.zeros(STEPS) if plate is None else plate}
        fitted = fit_of(**how)
        return Hypothesis((Candidate((name,), (RATE,)),), fitted, fitted.state.whitener, losses)

    return made


@pytest.fixture
def judge() -> Judge:
    """A choice in which all steps count."""
    return Judge(np.ones(STEPS, dtype=bool))


def test_a_candidate_that_spoils_a_channel_is_refused_with_that_reason(
    judge: Judge, explanation: Callable[..., Hypothesis]
) -> None:
    """Events gain 160 nats while the plate data lose 48: refused, and the plate is named."""
    best = explanation("nothing", np.full(STEPS, 10.0))
    x = explanation("drag", np.zeros(STEPS), np.full(STEPS, 3.0))
    rejected = judge.rejected(best, [x], 0, None)
    assert rejected is not None
    assert rejected.names == ("drag",)
    assert rejected.gain == pytest.approx(112.0)
    assert rejected.reason == "the plate data fit worse with it, by 48 +- 0 nats"


def test_a_gain_that_steps_contradict_is_refused_with_both_gains(
    judge: Judge, explanation: Callable[..., Hypothesis]
) -> None:
    """Thirty nats, half the steps for it and half against: the reason gives the gain and what was wanted."""
    best, x = explanation("nothing", np.zeros(STEPS)), explanation("drag", np.tile([-15.0, 11.25], STEPS // 2))
    rejected = judge.rejected(best, [x], 0, None)
    assert rejected is not None
    assert rejected.reason.startswith("the steps do not agree on its gain: 30 +- ")
    assert rejected.reason.endswith("a gain of 6 by 1.5 standard errors is required")


def test_what_gains_less_than_what_was_accepted_needs_no_reason(
    judge: Judge, explanation: Callable[..., Hypothesis]
) -> None:
    """A refused candidate behind the accepted one is no news, before it it is."""
    best, taken = explanation("nothing", np.full(STEPS, 10.0)), explanation("friction", np.zeros(STEPS))
    behind = explanation("drag", np.full(STEPS, 2.0), np.full(STEPS, 4.0))
    ahead = explanation("lag", np.full(STEPS, -5.0), np.full(STEPS, 2.0))
    assert judge.rejected(best, [behind, taken], 0, taken) is None
    found = judge.rejected(best, [behind, ahead, taken], 0, taken)
    assert found is not None and found.names == ("lag",)


@pytest.mark.parametrize(("before", "scatter", "accepted"), [(1.0, 1.0, True), (1.0, 3.0, False), (3.0, 3.0, True)])
def test_found_landings_may_cost_the_plate_a_trifle(
    judge: Judge, explanation: Callable[..., Hypothesis], before: float, scatter: float, accepted: bool
) -> None:
    """Events gain 1600 nats, plate data lose 12: refused only where these were noise before and scatter more now."""
    best = explanation("nothing", np.full(STEPS, 100.0), scatter=before)
    x = explanation("restitution", np.zeros(STEPS), np.full(STEPS, 0.75), scatter=scatter)
    assert (judge.choose(best, [x], 0) is x) is accepted
    assert (judge.rejected(best, [x], 0, None) is None) is accepted


@pytest.mark.parametrize(
    ("shown", "lost", "accepted"), [(True, True, True), (False, True, False), (True, False, False)]
)
def test_landings_that_are_lost_either_way_say_nothing_against_what_volts_show(
    judge: Judge, explanation: Callable[..., Hypothesis], shown: bool, lost: bool, accepted: bool
) -> None:
    """Plate data gain 480 nats and events lose 160: a mode that was identified is refused only by flights."""
    best, x = explanation("nothing", np.zeros(STEPS), np.full(STEPS, 30.0)), explanation("mode", np.full(STEPS, 10.0))
    best, x = (replace(h, whitener=replace(h.whitener, lost=lost)) for h in (replace(best, candidates=()), x))
    x.fitter.identified = {RATE: Prior(2.0, 0.1)} if shown else {}
    assert (judge.choose(best, [x], 0) is x) is accepted


def test_a_cause_whose_size_may_be_nothing_is_refused(judge: Judge, explanation: Callable[..., Hypothesis]) -> None:
    """Seventy nats of gain and an interval that holds zero: no name, and the interval is the reason."""
    best = explanation("nothing", np.full(STEPS, 4.5))
    x = explanation("table_resonance", np.zeros(STEPS), sized=False)
    assert judge.choose(best, [x], 0) is None
    rejected = judge.rejected(best, [x], 0, None)
    assert rejected is not None
    assert "hold the values at which it does nothing" in rejected.reason


def test_a_small_gain_is_called_small(judge: Judge, explanation: Callable[..., Hypothesis]) -> None:
    """Four nats are refused as too few, half a nat is not worth a word."""
    best = explanation("nothing", np.full(STEPS, 0.25))
    rejected = judge.rejected(best, [explanation("drag", np.zeros(STEPS))], 0, None)
    assert rejected is not None and rejected.reason == "too small a gain: 4.0 nats, wanted 6"
    assert judge.rejected(best, [explanation("drag", np.full(STEPS, 0.22))], 0, None) is None


@pytest.mark.parametrize(("steps", "scatter", "accepted"), [(2, 3.0, True), (1, 3.0, False), (2, 1.0, False)])
def test_two_steps_are_enough_where_more_than_noise_is_left_without_the_cause(
    judge: Judge, explanation: Callable[..., Hypothesis], steps: int, scatter: float, accepted: bool
) -> None:
    """A second cause that shows in two steps of sixteen stands beside a first one that leaves more than noise.

    Not where a single step speaks for it and another a little against it, nor where the first leaves only noise.
    """
    gained = np.where(np.arange(STEPS) < steps, 60.0, 0.0)
    gained[-1] = -1.0
    best, x = explanation("nothing", gained, scatter=scatter), explanation("restitution", np.zeros(STEPS))
    assert (judge.choose(best, [x], 1) is x) is accepted
    assert (judge.rejected(best, [x], 1, None) is None) is accepted


@pytest.mark.parametrize(("p", "accepted"), [(2e-4, True), (5e-3, False)])
def test_what_chance_gains_as_well_is_refused_with_its_probability(
    judge: Judge, explanation: Callable[..., Hypothesis], p: float, accepted: bool
) -> None:
    """Eight nats that all steps agree on stand where chance hardly gains as much, not where it does once in 200."""

    class Chance:
        """Chance of a known probability."""

        def p(self, _: Hypothesis) -> float:
            """The same for every hypothesis."""
            return p

    best, x = explanation("nothing", np.full(STEPS, 0.5)), explanation("drag", np.zeros(STEPS))
    chance = cast(ChanceGains, Chance())
    assert (judge.choose(best, [x], 0, chance) is x) is accepted
    rejected = judge.rejected(best, [x], 0, None, chance)
    assert (rejected is None) is accepted
    if rejected is not None:
        assert rejected.reason == "chance lets the best of all candidates gain as much: p = 0.005, wanted 0.001"


def test_of_those_that_tie_one_that_leaves_noise_comes_first(
    judge: Judge, explanation: Callable[..., Hypothesis]
) -> None:
    """A leader by a nat whose plate data scatter too much would need a second cause: the other is chosen."""
    best = explanation("nothing", np.full(STEPS, 10.0))
    leader, noise = explanation("drag", np.zeros(STEPS), scatter=3.0), explanation("damping", np.full(STEPS, 0.1))
    assert judge.choose(best, [noise, leader], 0) is noise
    assert judge.choose(best, [leader], 0) is leader


def test_what_noise_may_leave_is_no_worse_than_what_leaves_less(
    judge: Judge, explanation: Callable[..., Hypothesis], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A leader by a nat leaves 1.3 times the noise, which steps that share their errors may: it is chosen."""
    best = explanation("nothing", np.full(STEPS, 10.0))
    leader, other = explanation("drag", np.zeros(STEPS)), explanation("damping", np.full(STEPS, 0.1))
    monkeypatch.setattr(hypothesis, "rms_standardised", lambda model, *_: 1.3 if model is leader.model else 1.0)
    assert not leader.noise_like(FROZEN.noise_like_ratio) and other.noise_like(FROZEN.noise_like_ratio)
    assert judge.choose(best, [other, leader], 0) is leader


def test_chance_is_asked_only_about_those_that_could_be_chosen(
    judge: Judge, explanation: Callable[..., Hypothesis]
) -> None:
    """Of a leader, one that ties with it and one far behind, the last is never held against chance."""
    asked: list[Hypothesis] = []

    class Chance:
        def p(self, x: Hypothesis) -> float:
            """Never by chance."""
            asked.append(x)
            return 0.0

    best, leader = explanation("nothing", np.full(STEPS, 10.0)), explanation("drag", np.zeros(STEPS))
    close, far = explanation("damping", np.full(STEPS, 0.1)), explanation("friction", np.full(STEPS, 5.0))
    assert judge.choose(best, [far, close, leader], 0, cast(ChanceGains, Chance())) is leader
    assert [x.candidates[0].names for x in asked] == [("drag",), ("damping",)]


ALL = np.ones(10, dtype=np.bool_)


def test_a_further_effect_must_gain_more_than_the_first() -> None:
    """A clear gain of ten nats names a first effect and no second one; the refusal says what was wanted."""
    gain = LogScoreDifference.of(np.linspace(0.9, 1.1, 10), np.zeros(10), ALL)
    assert gain_refusal(gain, *required_gain(0, FROZEN)) is None
    assert gain_refusal(gain, *required_gain(1, FROZEN)) == "too small a gain: 10.0 nats, wanted 15"


def test_a_gain_on_which_replicates_differ_is_refused_in_their_name() -> None:
    """Two runs of ten that gain all are refused as runs that do not agree."""
    worse = np.where(np.arange(10) < 2, 20.0, -1.0)
    why = gain_refusal(LogScoreDifference.of(worse, np.zeros(10), ALL), *required_gain(1, FROZEN), replicate="run")
    assert why is not None and why.startswith("the runs do not agree on its gain: 32 +- ")


def test_what_leads_by_less_than_the_tie_is_not_distinguished() -> None:
    """A lead of three nats is a tie, a lead of thirty is none."""
    assert tied(np.zeros(10), np.full(10, 0.3), ALL, FROZEN)
    assert not tied(np.zeros(10), np.full(10, 3.0), ALL, FROZEN)


def test_chance_forbids_what_it_often_does() -> None:
    """One in a hundred is too often, one in ten thousand is not."""
    assert chance_refusal(1e-4, FROZEN) is None
    assert "p = 0.01" in str(chance_refusal(1e-2, FROZEN))


def test_what_hits_a_bound_stays_there_and_the_rest_follows() -> None:
    """The bounded minimum of a quadratic form is that of the rest, given what stands on its bound."""
    normal, gradient = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([3.0, 3.0])
    assert bounded_step(normal, gradient, np.full(2, -9.0), np.full(2, 9.0)) == pytest.approx([1.0, 1.0])
    assert bounded_step(normal, gradient, np.full(2, -9.0), np.array([0.5, 9.0])) == pytest.approx([0.5, 1.25])


def test_what_meets_its_bound_with_another_leaves_it_again() -> None:
    """Two that trade places leave their bounds together by the free minimum, yet only one of them belongs there."""
    slopes = np.array([[1.7, -1.3, 0.3], [-0.3, 0.0, 1.3], [0.6, -0.7, 0.1], [0.7, -0.5, -0.6]])
    rest, below, above = np.array([0.0, 2.0, 0.2, -0.6]), np.array([0.0, -0.5, -9.0]), np.array([9.0, 0.5, 9.0])
    step = bounded_step(slopes.T @ slopes, slopes.T @ rest, below, above)
    best = lsq_linear(slopes, rest, (below, above), method="bvls").x
    assert step == pytest.approx(best, abs=1e-6) and step[0] == 0.0 and abs(step[1]) < 0.5
