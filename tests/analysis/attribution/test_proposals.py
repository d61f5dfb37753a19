"""A round's proposals: every candidate beside the best hypothesis so far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.attribution.candidates import Candidate, candidates_of, trends_of
from analysis.attribution.coarse_search import subsample
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Refits
from analysis.attribution.proposals import Proposals
from analysis.attribution.selection import StepwiseSelection
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.values import TREND
from analysis.thresholds import FROZEN

RATIO = ("table_resonance", "mass_ratio")
UP, DOWN = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")
GAMMAS = (0.5, 1.1, 0.8, 1.3, 0.65, 0.95)


def test_a_drift_of_a_resonance_is_tried_like_any_other(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A resonance in place of friction: its drift leaves more than noise, and is itself no mode to look for."""
    model = fly_ramp({UP: 0.2, DOWN: 0.2}, 1, gammas=GAMMAS)
    selection = StepwiseSelection(model, fitter_of(model))
    resonance, nothing = Candidate(("table_resonance",), (RATIO,)), selection.declared()
    best = selection.refits.converged((resonance,), nothing.whitener, (RATIO,), {RATIO: 0.02})
    tried = list[str]()
    found = selection.proposals.round(best, trends_of(best.free), lambda name, _: tried.append(name))
    assert tried == ["table_resonance + parameter_drift"]
    assert [x.names for x in found] == [("table_resonance", "parameter_drift")]
    assert not found[0].noise_like(FROZEN.noise_like_ratio)


@pytest.mark.parametrize("part", [0.0, 0.999])
def test_weights_are_iterated_for_what_comes_near_the_best(
    fly_ramp: Callable[..., ForwardModel],
    fitter_of: Callable[[ForwardModel], Fitter],
    monkeypatch: pytest.MonkeyPatch,
    part: float,
) -> None:
    """Damping in place of friction gains less than friction: it keeps the old weights where that part is too small."""
    monkeypatch.setattr("analysis.attribution.proposals.FOLLOWED_PART", part)
    model = fly_ramp({UP: 0.2, DOWN: 0.2}, 1, gammas=GAMMAS)
    selection = StepwiseSelection(model, fitter_of(model))
    nothing, names = selection.declared(), {"viscous_damping", "coulomb_friction"}
    options = [c for c in candidates_of(model) if set(c.names) <= names]
    found = {x.names: x for x in selection.proposals.round(nothing, options, lambda *_: None)}
    assert found["coulomb_friction",].whitener is not nothing.whitener
    assert (found["viscous_damping",].whitener is nothing.whitener) == (part > 0.0)


@pytest.mark.parametrize("extra", [0.0, 0.2])
def test_a_fuller_form_is_fitted_from_its_special_case_where_it_promises_more(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter], extra: float
) -> None:
    """Friction that weakens with speed is no rival of a constant one that leaves nothing; it wins where hidden."""
    sizes = {"mu_kinetic": 0.15, "mu_extra": extra, "v_s_mps": 0.1, "exponent": 2.0}
    model = fly_ramp({("stribeck_friction", k): v for k, v in sizes.items()}, 1, gammas=GAMMAS)
    selection = StepwiseSelection(model, fitter_of(model))
    names = {"coulomb_friction", "stribeck_friction"}
    options = [c for c in candidates_of(model) if set(c.names) <= names]
    tried = list[str]()
    found = selection.proposals.round(selection.declared(), options, lambda name, _: tried.append(name))
    best = min(found, key=lambda x: float(x.per_step.sum()))
    assert sorted(set(tried)) == sorted(names)
    assert (
        (best.names == ("stribeck_friction",)) == (("stribeck_friction",) in [x.names for x in found]) == (extra > 0.0)
    )
    assert extra == 0.0 or best.fitted.values["stribeck_friction", "mu_extra"] == pytest.approx(extra, rel=0.2)


def test_a_fit_that_old_slopes_mislead_is_led_on_with_its_own(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """Of what is kept from before nothing moves with a calibration: friction is found all the same."""
    model = fly_ramp({UP: 0.2, DOWN: 0.2}, 1, gammas=GAMMAS)
    selection = StepwiseSelection(model, fitter_of(model))
    nothing, friction = selection.declared(), Candidate(("coulomb_friction",), (UP, DOWN), ({},))
    right = selection.proposals.add(nothing, friction)
    misled = replace(nothing, fitted=replace(nothing.fitted, bare=0.0 * nothing.fitted.bare))
    led_on = selection.proposals.add(misled, friction)
    assert right is not None
    assert led_on is not None
    assert led_on.fitted.loss == pytest.approx(right.fitted.loss, abs=0.5)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_small_rebound_is_sought_from_small_sizes(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter], seed: int
) -> None:
    """Of .005, where its own steps in landings hide it from a start at nothing, and from one at .03."""
    e0 = ("restitution", "e0")
    model = fly_ramp({e0: 0.005}, seed)
    selection = StepwiseSelection(model, fitter_of(model))
    options = [c for c in candidates_of(model) if c.free == (e0,)]
    found = selection.proposals.round(selection.declared(), options, lambda *_: None)
    assert found[0].fitted.values[e0] == pytest.approx(0.005, rel=0.15)


@pytest.mark.parametrize("drifts", [False, True])
def test_a_drift_gives_way_to_a_second_cause_that_does_as_well(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter], drifts: bool
) -> None:
    """Friction is chosen with its drift: it stays where friction drifts, and goes where the accelerometer is late."""
    drift = {(name, q + TREND): 0.08 for name, q in (UP, DOWN)}
    second = drift if drifts else {("accelerometer_lag", "delay_s"): 2e-4}
    model = fly_ramp({UP: 0.2, DOWN: 0.2, **second}, 1)
    options = [c for c in candidates_of(model) if c.names in (("coulomb_friction",), ("accelerometer_lag",))]
    selection = StepwiseSelection(model, fitter_of(model), library=options)
    nothing = selection.declared()
    friction = selection.proposals.add(nothing, next(c for c in options if c.free == (UP, DOWN)))
    assert friction is not None
    accepted = selection.proposals.add(friction, next(c for c in trends_of(friction.free) if len(c.free) == 2))
    assert accepted is not None
    assert selection._is_in_place_of_a_cause(nothing, accepted, [friction, accepted], 0) is not drifts


def test_an_earlier_cause_gives_way_to_one_that_came_near_it(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A weaker gravity was chosen for friction while the accelerometer's lateness was missing: friction is named."""
    lag = ("accelerometer_lag", "delay_s")
    selection = StepwiseSelection(model := fly_ramp({UP: 0.06, DOWN: 0.08, lag: 2e-4}, 1), fitter_of(model))
    nothing = selection.declared()
    options = {c.free: c for c in candidates_of(model)}
    gravity, friction = (
        selection.proposals.add(nothing, options[free]) for free in ((("local_gravity", "excess_mps2"),), (UP, DOWN))
    )
    assert gravity is not None and friction is not None
    both = selection.proposals.add(gravity, options[lag,])
    assert both is not None
    chosen, _ = selection._exchanged(both, [], {"local_gravity": [friction]}, retried=False)
    assert set(chosen.names) == {"coulomb_friction", "accelerometer_lag"}


@pytest.mark.parametrize("many", [True, False])
def test_a_few_of_many_flights_tell_which_candidates_could_win(
    fly_ramp: Callable[..., ForwardModel],
    fitter_of: Callable[[ForwardModel], Fitter],
    monkeypatch: pytest.MonkeyPatch,
    many: bool,
) -> None:
    """The cause of a ramp that is far off is found on few flights and fitted to all, to the same values as without."""
    model = fly_ramp({UP: 0.2, DOWN: 0.2}, 1, gammas=GAMMAS)
    selection, options = StepwiseSelection(model, fitter_of(model)), candidates_of(model)
    few = subsample(model, np.ones(len(GAMMAS), dtype=bool), 24)
    ahead = Proposals(Refits(Fitter(few, selection.fitter.priors, selection.fitter.train)), FROZEN)
    monkeypatch.setattr(selection.proposals, "_ahead", ahead if many else None)
    nothing = selection.declared()
    assert not nothing.noise_like(2.0)
    found = selection.proposals.round(nothing, options, lambda *_: None)
    best = min(found, key=lambda x: float(x.per_step.sum()))
    assert best.names == ("coulomb_friction",) and best.model is model
    assert best.fitted.values[UP] == pytest.approx(0.2, abs=3.0 * best.fitted.sigma(UP))
    rivals = [x for x in found if x.whitener is nothing.whitener]
    assert rivals and all(x.model is model for x in rivals)
