"""The verdict: when something is explained, when not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from analysis.attribution.hypothesis import Rejected
from analysis.loop.result import FittedParameter
from analysis.loop.tables import added_effects, rejected_json
from analysis.loop.verdict import confirmed_on_reserve, failed_tests, verdict_of
from analysis.residuals.lack_of_fit import GoodnessOfFit
from analysis.residuals.prediction_errors import Errors, GivenOpenings
from analysis.thresholds import FROZEN

NOISE = GoodnessOfFit(0.4, 1.02, 1.01, None, {}, 0.3, 0.5, 0.6)
HIT = Errors(10.0, 9.0, 11.0, 9.0, 30.0, 31.0, 1e-4, 90, 0.0)
FLOORS = (10.0, 30.0)


def verdict(named: bool, *tested: Any, **more: Any) -> str:
    """The verdict by the tests that fail."""
    return verdict_of(named, failed_tests(named, *tested, **more))


def test_a_named_cause_that_leaves_noise_is_an_explanation() -> None:
    """Remainder and held-out errors at the floor: explained with a name, nothing missing without."""
    assert verdict(True, NOISE, HIT, FLOORS, FROZEN) == "explained"
    assert verdict(False, NOISE, HIT, FLOORS, FROZEN) == "nothing_missing"


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
    assert verdict(True, NOISE, after, FLOORS, FROZEN) == "unexplained"


def test_what_chance_alone_makes_of_few_held_out_steps_is_no_miss() -> None:
    """Landings at 1.6 floors, where noise alone may reach 1.7: explained; at 1.8 not."""
    chance = (17.0, 40.0)
    assert verdict(True, NOISE, replace(HIT, landing_rms_us=16.0), FLOORS, FROZEN, chance) == "explained"
    assert verdict(True, NOISE, replace(HIT, landing_rms_us=18.0), FLOORS, FROZEN, chance) == "unexplained"


def test_a_floor_below_what_the_circuit_may_do_is_no_reason_to_doubt() -> None:
    """Take-offs known to half a microsecond and missed by one: the circuit's own physics, not a missing cause."""
    small = replace(HIT, takeoff_nmad_us=0.9)
    assert verdict(True, NOISE, small, (10.0, 0.45), FROZEN) == "explained"
    assert verdict(True, NOISE, replace(HIT, takeoff_nmad_us=2.0), (10.0, 0.45), FROZEN) == "unexplained"


def test_a_miss_without_a_name_is_left_to_the_tests_of_the_remainder() -> None:
    """One hidden bounce among clean held-out flights is no alarm: nothing was claimed that it could refute."""
    assert verdict(False, NOISE, replace(HIT, landing_rms_us=40.0), FLOORS, FROZEN) == "nothing_missing"


def test_nothing_is_not_missing_where_many_landings_are_other_events() -> None:
    """Nine of ninety held-out landings are other events and decide the error: no clean bill; one of them is chance."""
    missed = replace(HIT, landing_rms_us=102.0, landing_rms_us_without_lost=12.0)
    assert verdict(False, NOISE, replace(missed, lost=9), FLOORS, FROZEN) == "unexplained"
    assert verdict(False, NOISE, replace(missed, lost=1), FLOORS, FROZEN) == "nothing_missing"


def test_structure_beyond_the_floor_is_unexplained_with_or_without_a_name() -> None:
    """An improbable remainder counts only where it is also larger than a trifle."""
    loud = replace(NOISE, p_lack_of_fit=1e-9, ratio=1.6)
    assert verdict(True, loud, HIT, FLOORS, FROZEN) == "unexplained"
    assert verdict(False, loud, HIT, FLOORS, FROZEN) == "unexplained"
    assert verdict(True, replace(loud, ratio=1.1), HIT, FLOORS, FROZEN) == "explained"
    assert verdict(True, replace(NOISE, plate_rms_z=2.0), HIT, FLOORS, FROZEN) == "unexplained"


def test_a_pattern_in_landings_that_pass_says_nothing_against_take_offs_like_noise() -> None:
    """Take-offs that scatter by 1.3 of what is stated count by what is improbable in them, not in landings."""
    loud = replace(NOISE, p_lack_of_fit=1e-9, ratio=1.3, landing_ratio=0.97, p_takeoffs=0.02)
    assert verdict(True, loud, HIT, FLOORS, FROZEN) == "explained"
    for change in ({"p_takeoffs": 1e-9}, {"landing_ratio": 1.3}):
        assert verdict(True, replace(loud, **change), HIT, FLOORS, FROZEN) == "unexplained"


def test_a_run_without_rests_is_judged_by_its_landings() -> None:
    """No take-off was seen: there is neither an error nor a floor of them, and that is no reason to refuse."""
    after = replace(HIT, takeoff_nmad_us=math.nan, takeoff_rms_us=math.nan)
    assert verdict(True, NOISE, after, (10.0, math.nan), FROZEN) == "explained"


@pytest.mark.parametrize(("middle", "key", "size"), [(4.0, "relative_change", 0.05), (0.0, "change", 0.2)])
def test_a_drift_is_named_by_what_it_is(middle: float, key: str, size: float) -> None:
    """A trend is a fraction of the parameter's middle value, or a change in its own unit where the middle is zero."""
    rate = FittedParameter("viscous_damping", "rate_per_s", middle, 0.01, True)
    drift = added_effects(("viscous_damping",), (rate, replace(rate, value=0.2, trend=True)))[1]
    assert drift.name == "parameter_drift"
    assert drift.parameters[f"viscous_damping.rate_per_s_{key}"][0] == pytest.approx(size)


def _stands(gain_seen: float, gain_reserved: float, *, further: bool = False) -> bool:
    """Whether an effect that gains so much in each of 16 steps seen, and in 5 reserved ones, stands."""
    train = np.arange(21) % 4 != 2
    gain = np.where(train, gain_seen, gain_reserved)
    scatter = np.where(np.arange(21) % 3 == 0, 3.0, -1.5)
    return confirmed_on_reserve(np.zeros(21), scatter - gain, train, FROZEN, further=further)[0]


def test_a_small_gain_needs_the_reserved_steps() -> None:
    """A nat and a half a step stands if the reserved steps gain as well, and is withdrawn if they lose."""
    assert _stands(1.5, 1.5)
    assert not _stands(1.5, -1.0)


def test_a_large_gain_stands_whatever_few_reserved_steps_say() -> None:
    """Ten nats a step are no chance."""
    assert _stands(10.0, -1.0)


def test_a_further_cause_needs_the_reserved_steps_sooner() -> None:
    """Two nats in each step seen, none in the reserved: enough for a first cause, too little for a second."""
    assert _stands(2.3, -1.0)
    assert not _stands(2.3, -2.0, further=True)
    assert _stands(2.3, 1.0, further=True)
    assert _stands(10.0, -1.0, further=True)


def test_the_rejected_candidate_is_part_of_the_json() -> None:
    """Names, gain, error and reason; null where nothing was rejected, and for an error that does not exist."""
    assert rejected_json(None) is None
    found = rejected_json(Rejected(("restitution",), 1729.0, math.inf, "the plate data fit worse with it"))
    assert found == {
        "names": ["restitution"],
        "gain_nats": 1729.0,
        "standard_error": None,
        "reason": "the plate data fit worse with it",
    }


def test_landings_missed_as_far_as_their_openings_foretell_are_no_miss() -> None:
    """Held-out landings at 1.8 floors; what the openings tell of the tones leaves 1.1: explained; 1.9: not."""
    after = replace(HIT, landing_rms_us=18.0)
    told, untold = GivenOpenings(4.4, 4.0, 5.0), GivenOpenings(7.6, 4.0, 5.0)
    assert verdict(True, NOISE, after, FLOORS, FROZEN, given=told) == "explained"
    assert verdict(True, NOISE, after, FLOORS, FROZEN, given=untold) == "unexplained"


@pytest.mark.parametrize(
    ("reserved", "further", "stands"), [(-0.3, False, True), (-0.3, True, False), (-1.5, False, False)]
)
def test_few_reserved_steps_do_not_kill_a_weak_first_effect(reserved: float, further: bool, stands: bool) -> None:
    """Thirteen nats on twelve steps, one and a half lost on four: it stands, unless it is a further effect."""
    train = np.arange(16) % 4 != 2
    worse = np.where(train, 13.0 / 12.0, reserved) + np.where(np.arange(16) % 2, 0.5, -0.5) * train
    assert confirmed_on_reserve(worse, np.zeros(16), train, FROZEN, further=further)[0] == stands
