"""A template estimated from the accelerometer: its landings, and the threshold of its detector."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from analysis.events import template_estimate
from analysis.events.impact_template import FINE, LEAD, MIN_LANDINGS, ImpactTemplate, template_from_snippets
from analysis.events.template_estimate import FALSE_PER_HOUR, _all_snippets, _Found, scale_and_threshold
from analysis.flights.scan import survey
from analysis.signals import PAD, Piece
from daq.files.tables import STEP_DTYPE
from daq.recording import open_recording
from daq.setup.setup import Forcing

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


def test_motion_that_impacts_at_one_phase_bend_does_not_stay_in_their_waveform() -> None:
    """A ring of 2.6 kHz and .6 ms in every cycle of 31 Hz at 10 kHz: the waveform is that, over no slow motion."""
    rate_hz, rng = 10_000.0, np.random.default_rng(8)
    steps = np.zeros(12, STEP_DTYPE)
    steps["first_sample"], steps["n_samples"] = 6452 * np.arange(12), 6452
    steps["frequency_hz"], steps["ratio"] = 31.0, 1
    time_s = np.arange(12 * 6452) / rate_hz
    volts = np.repeat(np.linspace(0.1, 0.45, 12), 6452) * np.sin(2.0 * np.pi * 31.0 * time_s)
    volts += 1e-3 * rng.standard_normal(time_s.size)
    after_s = np.arange(60) / rate_hz
    for k, at_s in enumerate((np.arange(1, 238) + 0.71) / 31.0):
        first = math.ceil(at_s * rate_hz)
        own_s = after_s + first / rate_hz - at_s
        ring = (2.0 + 0.02 * k) * np.exp(-own_s / 6e-4) * np.sin(2.0 * np.pi * 2600.0 * own_s)
        volts[first : first + 60] += ring
    piece = Piece(0, time_s.size, {"accelerometer": np.pad(volts.astype(np.float32), PAD, mode="edge")})
    _, template = template_estimate.estimate_template([piece], steps, rate_hz, Forcing(frequency_hz=31.0))
    assert template is not None
    assert abs(np.mean(template.fine[: (LEAD - 2) * FINE])) < 1e-3 * np.abs(template.fine).max()
