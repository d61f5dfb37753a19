"""The verdict: when something is explained, when not."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from analysis.attribution.hypothesis import Rejected, SelectionResult
from analysis.loop import close_loop
from analysis.loop.close_loop import verdict_of
from analysis.residuals.forward_model import TREND
from analysis.residuals.lack_of_fit import GoodnessOfFit
from analysis.residuals.prediction_errors import Errors
from analysis.thresholds import FROZEN

NOISE = GoodnessOfFit(0.4, 1.02, 1.01, None, {}, 0.3, 0.5, 0.6)
HIT = Errors(10.0, 9.0, 11.0, 9.0, 30.0, 31.0, 1e-4, 90, 0.0)
FLOORS = (10.0, 30.0)


def test_a_named_cause_that_leaves_noise_is_an_explanation() -> None:
    """Remainder and held-out errors at the floor: explained with a name, nothing missing without."""
    assert verdict_of(True, NOISE, HIT, FLOORS, FROZEN) == "explained"
    assert verdict_of(False, NOISE, HIT, FLOORS, FROZEN) == "nothing_missing"


@pytest.mark.parametrize(
    "after",
    [
        replace(HIT, landing_rms_us=FROZEN.max_rms_over_floor * 10.0 + 0.1),
        replace(HIT, takeoff_nmad_us=46.0, takeoff_rms_us=47.0),
    ],
    ids=["landings", "take-offs"],
)
def test_no_clean_bill_while_held_out_events_are_missed(after: Errors) -> None:
    """However quiet the remainder's tests, a name whose held-out error is above 1.5 floors explains nothing."""
    assert verdict_of(True, NOISE, after, FLOORS, FROZEN) == "unexplained"


def test_what_chance_alone_makes_of_few_held_out_steps_is_no_miss() -> None:
    """Landings at 1.6 floors, where noise alone may reach 1.7: explained; at 1.8 not."""
    chance = (17.0, 40.0)
    assert verdict_of(True, NOISE, replace(HIT, landing_rms_us=16.0), FLOORS, FROZEN, chance) == "explained"
    assert verdict_of(True, NOISE, replace(HIT, landing_rms_us=18.0), FLOORS, FROZEN, chance) == "unexplained"


def test_a_floor_below_what_the_circuit_may_do_is_no_reason_to_doubt() -> None:
    """Take-offs known to half a microsecond and missed by one: the circuit's own physics, not a missing cause."""
    small = replace(HIT, takeoff_nmad_us=0.9)
    assert verdict_of(True, NOISE, small, (10.0, 0.45), FROZEN) == "explained"
    assert verdict_of(True, NOISE, replace(HIT, takeoff_nmad_us=2.0), (10.0, 0.45), FROZEN) == "unexplained"


def test_a_miss_without_a_name_is_left_to_the_tests_of_the_remainder() -> None:
    """One hidden bounce among clean held-out flights is no alarm: nothing was claimed that it could refute."""
    assert verdict_of(False, NOISE, replace(HIT, landing_rms_us=40.0), FLOORS, FROZEN) == "nothing_missing"


def test_structure_beyond_the_floor_is_unexplained_with_or_without_a_name() -> None:
    """An improbable remainder counts only where it is also larger than a trifle."""
    loud = replace(NOISE, p_lack_of_fit=1e-9, ratio=1.6)
    assert verdict_of(True, loud, HIT, FLOORS, FROZEN) == "unexplained"
    assert verdict_of(False, loud, HIT, FLOORS, FROZEN) == "unexplained"
    assert verdict_of(True, replace(loud, ratio=1.1), HIT, FLOORS, FROZEN) == "explained"
    assert verdict_of(True, replace(NOISE, plate_rms_z=2.0), HIT, FLOORS, FROZEN) == "unexplained"


def test_a_run_without_rests_is_judged_by_its_landings() -> None:
    """No take-off was seen: there is neither an error nor a floor of them, and that is no reason to refuse."""
    after = replace(HIT, takeoff_nmad_us=math.nan, takeoff_rms_us=math.nan)
    assert verdict_of(True, NOISE, after, (10.0, math.nan), FROZEN) == "explained"


@pytest.mark.parametrize(("middle", "key", "size"), [(4.0, "relative_change", 0.05), (0.0, "change", 0.2)])
def test_a_drift_is_named_by_what_it_is(middle: float, key: str, size: float) -> None:
    """A trend is a fraction of the parameter's middle value, or a change in its own unit where the middle is zero."""
    rate = ("viscous_damping", "rate_per_s")
    trend = (rate[0], rate[1] + TREND)
    fitted = SimpleNamespace(values={rate: middle, trend: 0.2}, sigma=lambda key: 0.01)
    best: Any = SimpleNamespace(names=("viscous_damping",), free=(rate, trend), fitted=fitted)
    drift = close_loop._found(best)[1]
    assert drift.name == "parameter_drift"
    assert drift.parameters[f"viscous_damping.rate_per_s_{key}"][0] == pytest.approx(size)


def _found(
    gain_seen: float, gain_reserved: float, monkeypatch: pytest.MonkeyPatch, *, further: bool = False
) -> tuple[bool, str]:
    """Whether a cause that gains so much in each of 16 steps, and in 5 reserved ones, stands; what is said last.

    A ``further`` one is added to another that stands beyond doubt.
    """
    train = np.arange(21) % 4 != 2
    spread = np.where(np.arange(21) % 3 == 0, 3.0, -1.5)

    def explanation(name: str, loss: np.ndarray) -> Any:
        fitted = SimpleNamespace(values={})
        return SimpleNamespace(names=(name,), per_step=np.where(train, loss, 0.0), fitted=fitted, whitener=loss)

    gain = np.where(train, gain_seen, gain_reserved)
    middle = explanation("friction", np.zeros(21))
    before, best = explanation("", np.full(21, 50.0 * further)), explanation("drag", spread - gain)
    earlier = (middle,) if further else ()
    monkeypatch.setattr(close_loop, "step_losses", lambda world, whitener, residuals: {"events": whitener})
    found = SelectionResult(before, best, (best,), (), ("round 1",), earlier=(before, *earlier) if earlier else ())
    world: Any = SimpleNamespace(residuals=lambda values: None)
    after = close_loop._borne_out(world, found, train, FROZEN)
    assert after.best is best or (after.rejected is not None and after.rejected.names == ("drag",))
    return after.best is best, after.rounds[-1]


def test_a_small_gain_needs_the_reserved_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A nat and a half a step stands if the reserved steps gain as well, and is withdrawn if they lose."""
    assert _found(1.5, 1.5, monkeypatch)[0]
    stands, said = _found(1.5, -1.0, monkeypatch)
    assert not stands and "drag: withdrawn" in said


def test_a_large_gain_stands_whatever_few_reserved_steps_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten nats a step are no chance."""
    assert _found(10.0, -1.0, monkeypatch)[0]


def test_a_further_cause_needs_the_reserved_steps_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two nats in each step seen, none in the reserved: enough for a first cause, too little for a second."""
    assert _found(2.3, -1.0, monkeypatch)[0]
    stands, said = _found(2.3, -2.0, monkeypatch, further=True)
    assert not stands and "drag: withdrawn" in said
    assert _found(2.3, 1.0, monkeypatch, further=True)[0]
    assert _found(10.0, -1.0, monkeypatch, further=True)[0]


def test_the_rejected_candidate_is_part_of_the_json() -> None:
    """Names, gain, error and reason; null where nothing was rejected, and for an error that does not exist."""
    assert close_loop._rejected(None) is None
    found = close_loop._rejected(Rejected(("restitution",), 1729.0, math.inf, "the plate data fit worse with it"))
    assert found == {
        "names": ["restitution"],
        "gain_nats": 1729.0,
        "standard_error": None,
        "reason": "the plate data fit worse with it",
    }


def test_where_nothing_was_found_nothing_is_withdrawn() -> None:
    """The declared model stands: no word of reserved steps, and no rejected candidate without a name."""
    nothing: Any = SimpleNamespace(names=())
    found = SelectionResult(nothing, nothing, (), (), ("round 1: nothing more gains beyond doubt",))
    assert close_loop._borne_out(nothing, found, np.ones(4, dtype=bool), FROZEN) is found
