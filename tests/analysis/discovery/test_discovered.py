"""A missing term on runs whose missing term is known: found by its covariate, its band around the truth, in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.attribution.candidates import Candidate
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.discovery.discover import discover
from analysis.discovery.fit import StackedResiduals, fit_in_flight
from analysis.discovery.search import SCREENING_TAILS, TermSearch, best_start
from analysis.discovery.terms import IN_FLIGHT, Curve, basis_of, event_term, knots_of, ranges_of
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.prediction_errors import held_out_errors, scored_rows
from analysis.residuals.values import ParameterId
from analysis.thresholds import FROZEN
from model.effects.curves import KNOTS

DEEPEST_M = 8e-3
HEIGHTS = np.linspace(0.0, DEEPEST_M, KNOTS)


def pull_mps2(height_m: np.ndarray) -> np.ndarray:
    """A magnet on the rod that pulls back above 2 mm."""
    return np.asarray(0.35 * 0.5 * (1.0 + np.tanh((height_m - 2e-3) / 6e-4)))


def latch() -> dict[ParameterId, float]:
    """The magnet, as the effect that carries a smooth force."""
    out: dict[ParameterId, float] = {
        ("smooth_force", "of"): 1.0,
        ("smooth_force", "start"): 0.0,
        ("smooth_force", "spacing"): HEIGHTS[1],
    }
    return out | {("smooth_force", f"c{i}"): -float(x) for i, x in enumerate(pull_mps2(HEIGHTS))}


def unexplained(model: ForwardModel, fitter: Fitter) -> Hypothesis:
    """The declared model alone, fitted."""
    whitener = Whitener.of(model, {})
    fitted = fitter.fit(whitener, (), {})
    return Hypothesis((), fitted, whitener, fitted.held_out(whitener))


def search_of(model: ForwardModel, fitter: Fitter) -> TermSearch:
    """A search beside nothing."""
    explanation = unexplained(model, fitter)
    tables = model.covariates(explanation.fitted.values)
    return TermSearch(model, fitter, explanation, (), tables)


@pytest.mark.slow
def test_a_magnet_on_the_rod_is_discovered_as_a_force_of_height(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """Covariate, direction, size, words; held-out landings at the floor; more than any constant pull."""
    model = fly_ramp(latch(), 1)
    fitter = fitter_of(model)
    found = discover(model, fitter, unexplained(model, fitter))
    assert found is not None
    assert (found.term, found.covariate.words) == ("force", "height")
    assert found.description.startswith("a downward pull rises from")
    assert "height" in found.description
    middle = float(np.interp(4e-3, found.curve.knots, found.curve.values))
    assert middle == pytest.approx(-float(pull_mps2(np.array([4e-3]))[0]), rel=0.1)
    assert found.gain.gain > 12.0
    assert found.after.landing_rms_us < 1.3 * found.noise_floor_us
    before = held_out_errors(model, {}, *scored_rows(model, {}, ~fitter.train))
    assert before.landing_rms_us > 5.0 * found.noise_floor_us


@pytest.mark.slow
def test_a_stop_that_bends_too_sharply_for_a_curve_is_found_by_its_formula(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """Above an edge a pull grows in proportion: edge and slope to a hundredth, held-out landings at the floor."""
    edge_m, slope_per_s2 = HEIGHTS[6], 3000.0
    values = -slope_per_s2 * np.maximum(2.0 * HEIGHTS - edge_m, 0.0)  # higher than the ball flies
    stop = {("smooth_force", f"c{i}"): float(x) for i, x in enumerate(values)}
    model = fly_ramp(latch() | {("smooth_force", "spacing"): 2.0 * HEIGHTS[1]} | stop, 1)
    fitter = fitter_of(model)
    found = discover(model, fitter, unexplained(model, fitter))
    assert found is not None
    assert (found.term, found.covariate.words, found.suggested) == ("force", "height", "threshold")
    form = found.form
    assert form is not None
    assert form.values == pytest.approx((-slope_per_s2, edge_m), rel=0.01)
    assert found.after.landing_rms_us < 1.3 * found.noise_floor_us


@pytest.mark.slow
def test_a_friction_that_grows_with_height_refutes_the_damping_named_for_it(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A formula of the height stands in place of the damping, and leaves the flights no more than noise."""
    friction = {("smooth_friction", f"c{i}"): float(x) for i, x in enumerate(15.0 * HEIGHTS)}
    where = {
        ("smooth_friction", "of"): 1.0,
        ("smooth_friction", "start"): 0.0,
        ("smooth_friction", "spacing"): HEIGHTS[1],
    }
    model = fly_ramp(where | friction, 1)
    fitter = fitter_of(model)
    damping = {("viscous_damping", "rate_per_s"): 1.0}
    whitener = Whitener.of(model, damping)
    fitted = fitter.fit(whitener, tuple(damping), damping)
    named = Candidate(("viscous_damping",), tuple(damping), (damping,))
    explanation = Hypothesis((named,), fitted, whitener, fitted.held_out(whitener))
    found = discover(model, fitter, explanation, in_place=True)
    assert found is not None
    assert (found.term, found.covariate.words) == ("friction", "height")
    assert found.instead_of == ("viscous_damping",)
    assert found.refutes(FROZEN)


@pytest.mark.slow
def test_nothing_is_discovered_in_noise(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A clean run has no missing term, however many covariates are asked."""
    model = fly_ramp({}, 2)
    fitter = fitter_of(model)
    assert discover(model, fitter, unexplained(model, fitter)) is None


def test_a_threshold_that_grows_with_the_dwell_time_is_followed(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """The take-off threshold at long and at short rests, each within its band or a tenth."""
    a, tau = 2.0, 4e-3
    model = fly_ramp({("adhesion", "a_mps2"): a, ("adhesion", "dwell_s"): tau}, 3)
    search = search_of(model, fitter_of(model))
    x = search.tables["dwell_s"]
    knots = knots_of(x[model.observations.scored])
    start = Curve(event_term("threshold", "dwell_s"), knots, np.full(len(knots), 1.5), basis_of(x, knots))
    found = search.refine(start)
    at = np.quantile(x[np.isfinite(x) & model.from_rest], [0.15, 0.5, 0.85])
    true = a * (1.0 - np.exp(-at / tau))
    half = np.interp(at, found.curve.points, found.band)
    assert (np.abs(found.curve.at(at) - true) < np.maximum(2.0 * half, 0.1 * true)).all()


def test_a_restitution_that_falls_with_the_impact_speed_is_followed(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """e = 0.12 - 0.3 v, found without a formula, to a hundredth where rebounds are long enough to be seen."""
    model = fly_ramp({("restitution", "e0"): 0.12, ("restitution", "e1_s_per_m"): 0.3}, 4)
    search = search_of(model, fitter_of(model))
    term = next(t for t in IN_FLIGHT if t.name == "restitution")
    span = ranges_of(search.tables, model.observations.scored)[term.of]
    stack = StackedResiduals.of(model, search.values, search.train)
    start = best_start(model, search.values, stack, Curve.even(term, span), search.dwell)
    look = fit_in_flight(model, search.values, stack, start, search.dwell, SCREENING_TAILS)
    found = search.refine(look)
    speeds = np.quantile(search.tables["impact_mps"][model.observations.scored], [0.3, 0.4, 0.5])
    assert found.curve.at(speeds) == pytest.approx(0.12 - 0.3 * speeds, abs=0.012)


@pytest.mark.slow
def test_the_band_of_a_smooth_force_holds_the_truth(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A pull that grows evenly with height: in five runs the truth lies within the band where 95 % says so."""
    spring, inside = 40.0, []
    for seed in range(5, 10):
        model = fly_ramp({("position_force", "spring_per_s2"): spring}, seed)
        search = search_of(model, fitter_of(model))
        term = next(t for t in IN_FLIGHT if t.name == "force" and t.of == "height_m")
        found = search.refine(Curve.even(term, ranges_of(search.tables, model.observations.scored)[term.of]))
        x, half = found.curve.points, found.band
        inside.append(np.abs(found.curve.at(x) + spring * x) <= half)
        assert np.median(half) < 0.1 * spring * x[-1]  # and it says something
    assert np.mean(inside) > 0.85


def test_the_scatter_of_a_term_does_not_use_the_reserved_steps(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """Landings of reserved steps moved by half a millisecond: the scatter by which terms are chosen is the same."""
    model = fly_ramp({("position_force", "spring_per_s2"): 40.0}, 5)
    ev, reserved = model.observations, ~fitter_of(model).train
    late = np.where(reserved[ev.measured.step], 5e-4, 0.0)
    moved = replace(ev, measured=replace(ev.measured, landing_s=ev.measured.landing_s + late))
    term = next(t for t in IN_FLIGHT if t.name == "force" and t.of == "height_m")
    curve = Curve.even(term, (0.0, DEEPEST_M), 5)
    found = [search_of(w, fitter_of(w)).refine(curve) for w in (model, ForwardModel(moved, {}))]
    assert found[0].scatter == pytest.approx(found[1].scatter, rel=1e-9)
    assert 0.7 < found[0].scatter < 1.3


def test_a_quantity_that_never_varies_carries_no_term(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """Flights of no height, rests that are known of none: terms of other quantities are screened without them."""
    model = fly_ramp({}, 0, gammas=(0.8, 1.1))
    search = search_of(model, fitter_of(model))
    n = len(model.observations)
    search.tables = search.tables | {"height_m": np.zeros(n), "dwell_s": np.full(n, np.nan)}
    named = {t.curve.term.of for t in search.screen()}
    assert named and not named & {"dwell_s", "height_m", "since_impact_s"}
