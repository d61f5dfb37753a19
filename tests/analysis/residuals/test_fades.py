"""Flights in the fade from step to step: which motions the plate's lies between, and how it then rings in the hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import shakerbench as sb
from analysis.residuals.fades import Fades
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import Observations, observations_from

MODE = {"table_resonance": {"frequency_hz": 7.5, "damping": 0.04, "mass_ratio": 0.03}}


def test_a_flight_in_a_fade_belongs_to_two_steps() -> None:
    """Before half of a fade the next step has the small share, after it the step before; none in a hold or in rest."""
    fades = Fades(np.array([0.0, 2.0, 4.0]), np.array([1.0, 1.0, 0.0]))
    step, time_s = np.array([0, 0, 0, 1, 1, 2]), np.array([0.5, 1.5, 2.25, 2.75, 3.5, 4.1])
    other, share = fades.others(step, time_s)
    assert share == pytest.approx([0.5, 0.0, 0.15625, 0.15625, 0.0, 0.0])
    assert other[[0, 2, 3]].tolist() == [-1, 1, 0]
    assert fades.before_half(np.array([1, 1, 0]), np.array([2.4, 2.6, 0.1])).tolist() == [True, False, False]


def scatter_us(observations: Observations) -> float:
    """Rms of the landings' residuals about the mean of their step, with the true mode."""
    residual, step = ForwardModel(observations, MODE).residuals({}).landing_s, observations.measured.step
    scored = observations.scored & np.isfinite(residual)
    apart = [residual[scored & (step == s)] for s in np.unique(step[scored])]
    return 1e6 * float(np.sqrt(np.mean(np.concatenate([x - x.mean() for x in apart]) ** 2)))


def test_a_mode_rings_on_from_flights_in_the_fade(tmp_path: Path) -> None:
    """Struck on the plate as it moved in the fade, the mode is known in the hold; in its steps' motions it is not."""
    values = {"ramp.gamma": [1.1, 1.7, 2.3], "ramp.settle_cycles": 8, "ramp.hold_cycles": 12}
    path = tmp_path / "ringing.h5"
    sb.run(sb.load_profile("simulated").with_values(values), path, scenario="resonance", seed=5)
    observations = observations_from([path])
    unread = replace(observations.measured, gained_mps=None, pressed_mps=None, pressed_at=None)
    abrupt = replace(observations, measured=replace(unread, beside=None, share=None))
    assert scatter_us(replace(observations, measured=unread)) < 8.0
    assert scatter_us(abrupt) > 3.0 * scatter_us(replace(observations, measured=unread))
    assert scatter_us(observations) < 8.0
