"""Rules of choice, the same for steps of a run and for many runs."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.attribution.comparison import LogScoreDifference, chance_refusal, gain_refusal, required_gain, tied
from analysis.attribution.fit import bounded_step
from analysis.thresholds import FROZEN

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
