"""Effects that the reserved steps contradict are withdrawn; flights that fit no motion of the plate are refused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from analysis.attribution.candidates import Candidate
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Hypothesis
from analysis.attribution.selection import SelectionResult
from analysis.discovery.symbolic import FORMS
from analysis.loop import close_loop
from analysis.loop.close_loop import FittedLoop, completed, refuse_far_off, withdraw_unconfirmed
from analysis.loop.result import ClosedLoop
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import ParameterId
from analysis.thresholds import FROZEN
from daq.setup.errors import InputError
from tests.loops import changed, found_by

UP, DOWN = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")
DRAG = ("quadratic_drag", "k_per_m")


@pytest.fixture(scope="module")
def fits(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> tuple[Fitter, Hypothesis, Hypothesis, Hypothesis]:
    """A ramp with friction, and its fits by nothing, by friction and by drag."""
    model = fly_ramp({UP: 0.1, DOWN: 0.1}, 6)
    fitter = fitter_of(model)

    def fit(start: dict[ParameterId, float]) -> Hypothesis:
        whitener = Whitener.of(model, start)
        fitted = fitter.fit(whitener, tuple(start), start)
        names = tuple(dict.fromkeys(name for name, _ in start))
        candidates = (Candidate(names, tuple(start), (start,)),) if start else ()
        return Hypothesis(candidates, fitted, whitener, fitted.held_out(whitener))

    return fitter, fit({}), fit({UP: 0.1, DOWN: 0.1}), fit({DRAG: 0.1})


def test_what_the_reserved_steps_confirm_stands(fits: tuple[Fitter, Hypothesis, Hypothesis, Hypothesis]) -> None:
    """Friction on a ramp that has it: the selection stays as it is; so does one that found nothing."""
    fitter, nothing, friction, _ = fits
    for found in (SelectionResult(nothing, friction, (friction,), ()), SelectionResult(nothing, nothing, (), ())):
        assert withdraw_unconfirmed(fitter.model, found, fitter.train, FROZEN) is found


def test_what_the_reserved_steps_contradict_is_withdrawn(
    fits: tuple[Fitter, Hypothesis, Hypothesis, Hypothesis],
) -> None:
    """Drag in the place of a friction that fits better: friction stands again, drag is the rejected candidate."""
    fitter, nothing, friction, drag = fits
    found = SelectionResult(nothing, drag, (drag,), (), ("round 1",), earlier=(nothing, friction))
    left = withdraw_unconfirmed(fitter.model, found, fitter.train, FROZEN)
    assert left.best is friction and left.ties == (friction,) and left.earlier == (nothing,)
    assert left.rounds[-1] == "the steps held out of the fit do not improve with quadratic_drag: withdrawn"
    assert left.rejected is not None and left.rejected.names == ("quadratic_drag",) and left.rejected.gain < 0.0


@pytest.mark.parametrize(
    ("left_p", "law_p", "verdict"), [(1e-6, 0.5, "unexplained"), (1e-6, 1e-6, "explained"), (0.5, 0.5, "explained")]
)
def test_a_formula_that_leaves_only_noise_refutes_an_explanation_that_does_not(
    left_p: float,
    law_p: float,
    verdict: str,
    closed_loop: ClosedLoop,
    fits: tuple[Fitter, Hypothesis, Hypothesis, Hypothesis],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It must be more than noise by probability what the named effects leave, and no more what the formula leaves."""
    fitter, nothing, friction, _ = fits
    loop = changed(closed_loop, remainder=replace(closed_loop.remainder, p_lack_of_fit=left_p))
    found = found_by(loop, "force", "height_m", FORMS[1], "m/s^2").discovered
    assert found is not None
    found = replace(found, instead_of=("coulomb_friction",), p_lack_of_fit=law_p)
    monkeypatch.setattr(close_loop, "discover", lambda *_, in_place: found if in_place else None)
    fitted = FittedLoop(fitter.model, SelectionResult(nothing, friction, (friction,), ()))
    ended = completed(loop, fitted)
    assert ended.verdict == verdict
    assert [failed.test for failed in ended.failed] == (["law"] if verdict == "unexplained" else [])
    assert (ended.discovered is found) == (verdict == "unexplained")


def test_take_offs_and_landings_far_off_are_refused(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Events a quarter of a cycle off stop the search with what to check; restitution moves landings alone."""
    refuse_far_off(fly_ramp({("restitution", "e0"): 0.5}, 6), [Path("run.h5")])
    right = fly_ramp({}, 6).observations
    late = replace(right.measured, opening_s=right.measured.opening_s + 0.01, landing_s=right.measured.landing_s + 0.01)
    with pytest.raises(InputError, match=r"run\.h5: .* misses take-offs by \d+ ms and landings by \d+ ms.*check sign"):
        refuse_far_off(ForwardModel(replace(right, measured=late), {}), [Path("run.h5")])
