"""Evidence of several recordings in one table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.events.edge_jitter import Scatter
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import ContactCircuit, join
from analysis.residuals.plate_data.plate_observables import CLOCK, OFFSET

FRICTION = {("coulomb_friction", "mu_up"): 0.1, ("coulomb_friction", "mu_down"): 0.1}
QUIET = (0.22, 0.23, 0.24, 0.25)


def test_joined_recordings_keep_their_own_steps(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Two runs in one table: flights of the second point at its own steps, and predict as they did alone."""
    one, two = (fly_ramp(FRICTION, seed, gammas=QUIET).observations for seed in (1, 2))
    both = join([one, two])
    assert len(both) == len(one) + len(two)
    assert both.measured.step[len(one)] == len(one.steps) + two.measured.step[0]
    assert set(both.steps.recording) == {0, 1}
    assert len(both.plate) == len(one.plate) + len(two.plate)
    alone, together = ForwardModel(two, {}).residuals(FRICTION), ForwardModel(both, {}).residuals(FRICTION)
    assert together.landing_s[len(one) :] == pytest.approx(alone.landing_s, abs=1e-9, nan_ok=True)
    assert together.plate[len(one.plate) :] == pytest.approx(alone.plate)


def test_a_short_recording_has_the_jitter_of_all(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Edges of a recording in which too few steps repeat are as uncertain as the steps of all recordings tell."""
    short, long = (fly_ramp(FRICTION, seed, gammas=QUIET).observations for seed in (1, 2))
    short = replace(short, circuit=ContactCircuit(0.0, (Scatter(np.full(1, 9e-12)), Scatter())))
    long = replace(long, circuit=ContactCircuit(0.0, (Scatter(np.full(3, 9e-12)), Scatter(np.full(4, 16e-12)))))
    both, n = join([short, long]), len(short)
    assert both.opening_sigma_s[:n] == pytest.approx(np.hypot(short.opening_sigma_s, 3e-6))
    assert both.landing_sigma_s[:n] == pytest.approx(np.hypot(short.landing_sigma_s, 4e-6))
    assert both.opening_sigma_s[n:] == pytest.approx(long.opening_sigma_s)
    assert [len(x.excess_s2) for x in both.circuit.scatters] == [4, 4]


@pytest.mark.parametrize(("kind", "note"), [(OFFSET, "zero wanders"), (CLOCK, "tells little of the clock")])
def test_a_zero_or_clock_that_wanders_from_file_to_file_is_as_uncertain_as_it_wanders(
    fly_ramp: Callable[..., ForwardModel], kind: int, note: str
) -> None:
    """Recordings that differ by more than each one's own uncertainty: a note, and wider data."""
    one = fly_ramp({}, 1, gammas=QUIET).observations
    few = one.plate.among(np.arange(4))
    zeros_mps2 = 0.05 * np.random.default_rng(2).standard_normal(6)
    parts = [
        replace(
            one, plate=replace(few, kind=np.full(4, kind), value=np.full(4, zero), sigma=np.full(4, 1e-3))
        )
        for zero in zeros_mps2
    ]  # fmt: skip
    both = join(parts)
    assert both.plate.sigma.min() > 0.03 and any(note in x for x in both.notes)
    assert join(parts[:1] * 6).plate.sigma.max() < 2e-3
