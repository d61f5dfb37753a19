"""What forms that do nearly as well add to an interval."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from scipy import stats

from analysis.attribution.candidates import Candidate, candidates_of
from analysis.attribution.fit import Fitter
from analysis.attribution.selection import StepwiseSelection
from analysis.loop.tables import _interval, beyond_own_form
from analysis.residuals.forward_model import ForwardModel
from analysis.thresholds import FROZEN

SPRING, MAGNET, REACH = (("position_force", q) for q in ("spring_per_s2", "magnet_mps2", "range_m"))
GAMMAS = (0.5, 1.1, 0.8, 1.3, 0.65, 0.95)


def test_a_mixture_of_one_is_its_own_interval_and_of_two_holds_both() -> None:
    """One normal part alone, or with another of no weight; of two alike, each end leaves a twentieth of its part."""
    assert _interval([(1.0, 3.0, 0.5)]) == pytest.approx((3.0 - 0.98, 3.0 + 0.98), abs=1e-3)
    assert _interval([(1.0, 3.0, 0.5), (1e-12, 90.0, 1.0)]) == pytest.approx((2.02, 3.98), abs=1e-3)
    reach = 0.5 * stats.norm.ppf(0.95)
    assert _interval([(1.0, 3.0, 0.5), (1.0, 30.0, 0.5)]) == pytest.approx((3.0 - reach, 30.0 + reach), abs=1e-3)


@pytest.mark.parametrize("pull", [0.0, 0.06])
def test_a_spring_is_known_no_better_than_a_weak_magnet_beside_it_allows(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter], pull: float
) -> None:
    """The spring alone is off by what the magnet does: its interval reaches the truth, no farther without."""
    model = fly_ramp({SPRING: 20.0, MAGNET: pull, REACH: 2e-3}, 4, gammas=GAMMAS)
    selection = StepwiseSelection(model, fitter_of(model))
    alone = Candidate(("position_force",), (SPRING,), ({},))
    added = selection.proposals.add(selection.declared(), alone)
    assert added is not None
    best = selection.refits.settled(added)
    fuller = [c for c in candidates_of(model) if c.names == ("position_force",) and set(alone.free) < set(c.free)]
    sigma = best.fitted.sigma(SPRING)
    below, above = beyond_own_form(best, fuller, FROZEN)[SPRING]
    off = 20.0 - best.fitted.values[SPRING]
    assert (abs(off) > 2.5 * sigma) == (pull > 0.0)
    assert -1.96 * sigma - below < off < 1.96 * sigma + above
    assert (below + above < sigma) == (pull == 0.0)
