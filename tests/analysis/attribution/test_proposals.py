"""A round's proposals: every candidate beside the best hypothesis so far."""

from __future__ import annotations

from collections.abc import Callable

from analysis.attribution.candidates import Candidate, trends_of
from analysis.attribution.fit import Fitter
from analysis.attribution.selection import StepwiseSelection
from analysis.residuals.forward_model import ForwardModel
from analysis.thresholds import FROZEN

RATIO = ("table_resonance", "mass_ratio")


def test_a_drift_of_a_resonance_is_tried_like_any_other(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A resonance in place of friction: its drift leaves more than noise, and is itself no mode to look for."""
    up, down = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")
    world = fly_ramp({up: 0.2, down: 0.2}, 1, gammas=(0.5, 1.1, 0.8, 1.3, 0.65, 0.95))
    selection = StepwiseSelection(world, fitter_of(world))
    resonance, nothing = Candidate(("table_resonance",), (RATIO,)), selection.declared()
    best = selection.refits.converged((resonance,), nothing.whitener, (RATIO,), {RATIO: 0.02})
    tried = list[str]()
    found = selection.proposals.round(best, trends_of(best.free), lambda name, _: tried.append(name))
    assert tried == ["table_resonance + parameter_drift"]
    assert [x.names for x in found] == [("table_resonance", "parameter_drift")]
    assert not found[0].noise_like(FROZEN.noise_like_ratio)
