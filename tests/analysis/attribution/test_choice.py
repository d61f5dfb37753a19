"""Refusals: every candidate that gains and does not stand has its reason."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from analysis.attribution import choice
from analysis.attribution.candidates import Candidate
from analysis.attribution.choice import Judge
from analysis.attribution.hypothesis import Hypothesis

STEPS = 16


def explanation(
    name: str, events: NDArray[np.float64], plate: NDArray[np.float64] | None = None, *, sized: bool = True
) -> Hypothesis:
    """Losses of a candidate by step, without the fit behind them; ``sized``: its parameters differ from nothing."""
    losses = {"events": events, "plate": np.zeros(STEPS) if plate is None else plate}
    whitener: Any = SimpleNamespace(excess_s=(1e-6, 1e-6), total_s=np.ones(3), lost=False)
    fitted: Any = SimpleNamespace(
        differs=lambda keys: sized, fitter=SimpleNamespace(world=None), values={}, prior_penalty=0.0
    )
    return Hypothesis((Candidate((name,), ((name, "size"),)),), fitted, whitener, losses)


@pytest.fixture
def judge() -> Judge:
    """All steps speak."""
    return Judge(np.ones(STEPS, dtype=bool))


def test_a_candidate_that_spoils_a_channel_is_refused_with_that_reason(judge: Judge) -> None:
    """Events gain 160 nats while the plate data lose 48: refused, and the plate is named."""
    best = explanation("nothing", np.full(STEPS, 10.0))
    x = explanation("drag", np.zeros(STEPS), np.full(STEPS, 3.0))
    rejected = judge.rejected(best, [x], 0, None)
    assert rejected is not None
    assert rejected.names == ("drag",)
    assert rejected.gain == pytest.approx(112.0)
    assert rejected.reason == "the plate data fit worse with it, by 48 +- 0 nats"


def test_a_gain_that_steps_contradict_is_refused_with_both_gains(judge: Judge) -> None:
    """Thirty nats, half the steps for it and half against: the reason gives the gain and what was wanted."""
    best, x = explanation("nothing", np.zeros(STEPS)), explanation("drag", np.tile([-15.0, 11.25], STEPS // 2))
    rejected = judge.rejected(best, [x], 0, None)
    assert rejected is not None
    assert rejected.reason.startswith("the steps do not agree on its gain: 30 +- ")
    assert "wanted 12 and 2 standard errors" in rejected.reason


def test_what_gains_less_than_what_was_accepted_needs_no_reason(judge: Judge) -> None:
    """A refused candidate behind the accepted one is no news, before it it is."""
    best, taken = explanation("nothing", np.full(STEPS, 10.0)), explanation("friction", np.zeros(STEPS))
    behind = explanation("drag", np.full(STEPS, 2.0), np.full(STEPS, 4.0))
    ahead = explanation("lag", np.full(STEPS, -5.0), np.full(STEPS, 2.0))
    assert judge.rejected(best, [behind, taken], 0, taken) is None
    found = judge.rejected(best, [behind, ahead, taken], 0, taken)
    assert found is not None and found.names == ("lag",)


@pytest.mark.parametrize(("ratio", "accepted"), [(1.1, True), (1.4, False)])
def test_found_landings_may_cost_the_plate_a_trifle(
    judge: Judge, monkeypatch: pytest.MonkeyPatch, ratio: float, accepted: bool
) -> None:
    """Events gain 1600 nats, plate data lose 12 and are still noise: calibrations had followed that noise before."""
    monkeypatch.setattr(choice, "plate_rms_standardised", lambda world, values: ratio)
    best = explanation("nothing", np.full(STEPS, 100.0))
    x = explanation("restitution", np.zeros(STEPS), np.full(STEPS, 0.75))
    assert (judge.choose(best, [x], 0) is x) is accepted
    assert (judge.rejected(best, [x], 0, None) is None) is accepted


def test_a_cause_whose_size_may_be_nothing_is_refused(judge: Judge) -> None:
    """Seventy nats of gain and an interval that holds zero: no name, and the interval is the reason."""
    best = explanation("nothing", np.full(STEPS, 4.5))
    x = explanation("table_resonance", np.zeros(STEPS), sized=False)
    assert judge.choose(best, [x], 0) is None
    rejected = judge.rejected(best, [x], 0, None)
    assert rejected is not None
    assert "hold the values at which it does nothing" in rejected.reason


def test_a_small_gain_is_called_small(judge: Judge) -> None:
    """Eight nats are refused as too few, half a nat is not worth a word."""
    best = explanation("nothing", np.full(STEPS, 0.5))
    rejected = judge.rejected(best, [explanation("drag", np.zeros(STEPS))], 0, None)
    assert rejected is not None and rejected.reason == "too small a gain: 8.0 nats, wanted 12"
    assert judge.rejected(best, [explanation("drag", np.full(STEPS, 0.47))], 0, None) is None
