"""A template estimated from the accelerometer: its landings, and the threshold of its detector."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from analysis.events import template_estimate
from analysis.events.impact_template import FINE, MIN_LANDINGS, ImpactTemplate, template_from_snippets
from analysis.events.template_estimate import FALSE_PER_HOUR, _all_snippets, _Found, scale_and_threshold
from analysis.flights.scan import survey
from daq.recording import open_recording

RATE_HZ = 20000.0


def test_a_threshold_comes_from_the_output_of_the_detector() -> None:
    """Normal output: six sigmas, whatever its size. A heavier tail: higher, and passed no more often than stated."""
    rng = np.random.default_rng(2)
    scale, threshold = scale_and_threshold(1.7 * rng.standard_normal(400_000), RATE_HZ)
    assert scale == pytest.approx(1.7, rel=0.01)
    assert threshold == pytest.approx(6.2, abs=0.3)

    def bursts(n: int) -> np.ndarray:
        return rng.standard_normal(n) * np.where(rng.random(n) < 0.1, 2.0, 1.0)

    scale, threshold = scale_and_threshold(bursts(400_000), RATE_HZ)
    assert threshold > 7.0
    hours = 20_000_000 / RATE_HZ / 3600.0
    assert np.count_nonzero(bursts(20_000_000) > threshold * scale) <= 3 + hours * FALSE_PER_HOUR


def test_impacts_that_follow_each_other_within_the_longest_ringing_are_learnt() -> None:
    """One every 17 ms, as at c = 2: none has 25.6 ms of rest before it, and all have died away by the next."""
    places = 425.0 * np.arange(1, 41)
    found = _Found(places - 0.5, np.full(40, 50.0), np.zeros(40), np.full(40, 425.0))
    clean = [(np.zeros(20_000), np.ones(20_000, np.bool_))]
    snippets, fractions = _all_snippets(clean, [found], 25_000.0, None, 1)
    assert MIN_LANDINGS <= len(snippets) == len(fractions) and snippets.shape[1] < 425


def test_a_template_too_short_for_slow_motion_to_show_is_learnt_longer(make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1,563 impacts cut off at 4 g none was found: the second average, as short as the first, told no template."""
    lengths = list[int]()

    def short_ones_fail(snippets: np.ndarray, *rest: Any, aligned: bool) -> ImpactTemplate | None:
        found = template_from_snippets(snippets, *rest, aligned=aligned)
        if aligned and snippets.shape[1] <= lengths[-1]:
            return None
        assert found is not None
        lengths.append(found.fine.size // FINE)
        return found

    monkeypatch.setattr(template_estimate, "template_from_snippets", short_ones_fail)
    with open_recording(make([0.8, 1.1]).path) as recording:
        assert survey(recording).template is not None
    assert len(lengths) == 3
