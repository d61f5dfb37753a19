"""The formula behind a term: recovered where it is short."""

from __future__ import annotations

from collections.abc import Callable

from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.discovery.search import TermSearch
from analysis.discovery.symbolic import search_forms
from analysis.discovery.terms import IN_FLIGHT, Curve, ranges_of
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.thresholds import FROZEN

SPRING = 40.0


def test_the_law_of_a_spring_is_recovered(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A force of height that is a spring's: among the forms the one in proportion, its stiffness within three sigma."""
    model = fly_ramp({("position_force", "spring_per_s2"): SPRING}, 5)
    fitter = fitter_of(model)
    whitener = Whitener.of(model, {})
    fitted = fitter.fit(whitener, (), {})
    nothing = Hypothesis((), fitted, whitener, fitted.held_out(whitener))
    tables = model.covariates(fitted.values)
    search = TermSearch(model, fitter, nothing, (), tables)
    term = next(t for t in IN_FLIGHT if t.name == "force" and t.of == "height_m")
    found = search.refine(Curve.even(term, ranges_of(tables, model.observations.scored)[term.of], 5))
    forms = search_forms(found, tables, FROZEN)
    assert forms.suggested == "proportional"
    form = next(f for f in forms.tried if f.name == forms.suggested)
    assert form.units == ("m/s^2/m",) and form.as_good
    assert abs(form.values[0] + SPRING) < 3.0 * form.sigmas[0]
    assert form.sigmas[0] < 0.05 * SPRING
