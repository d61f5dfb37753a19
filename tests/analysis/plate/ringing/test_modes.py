"""A plate mode identified from what the ball does to the plate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import FlightFlag, flights_of
from analysis.plate.ringing.modes import PlateMode, _Regression, answer, identified_mode
from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported
from daq.recording import open_recording


def _found(
    folder: Path, hidden: dict[str, float], missed: Sequence[int] = (), drive_share: float = 1.0
) -> PlateMode | None:
    gammas = np.random.default_rng(1).permutation(np.round(np.linspace(0.5, 2.6, 27), 4))
    run = other_plant.Run(hidden=hidden, seed=1, gammas=tuple(gammas.tolist()), spikes=True, closure_s=5e-4)
    volts = other_plant.simulate(run)
    volts["drive_v"] *= drive_share
    path = imported(volts, other_plant.profile_of(run), folder)
    with open_recording(path) as recording:
        flights = flights_of(recording)
        true = ~flights.has(FlightFlag.FALSE)
        true[list(missed)] = False
        return identified_mode(recording, flights.takeoff_s[true], flights.landing_s[true], 1e-3)


def test_a_mode_is_identified_from_recorded_volts(tmp_path: Path) -> None:
    """Frequency, damping and mass ratio come out without a prediction of a flight."""
    hidden = {"table_resonance.hz": 2.5, "table_resonance.damping": 0.02, "table_resonance.ratio": 0.25}
    mode = _found(tmp_path, hidden)
    assert mode is not None
    assert mode.frequency_hz == pytest.approx(2.5, rel=0.01)
    assert mode.damping == pytest.approx(0.02, rel=0.15)
    assert mode.mass_ratio == pytest.approx(0.25, rel=0.03)
    assert mode.remainder_mps2 < 0.5 * mode.before_mps2


def test_a_flight_that_was_missed_leaves_the_mode_and_its_error_as_they_are(tmp_path: Path) -> None:
    """Its push is unknown: the half second is left out, and the plate rings on from an unknown state."""
    hidden = {"table_resonance.hz": 5.1, "table_resonance.damping": 0.0123, "table_resonance.ratio": 0.21}
    mode = _found(tmp_path, hidden, missed=(260,))
    assert mode is not None
    off = np.array([mode.frequency_hz / 5.1, mode.damping / 0.0123, mode.mass_ratio / 0.21]) - 1.0
    assert (np.abs(off) < [0.01, 0.15, 0.03]).all()
    size = np.array(mode.sigmas()) / [5.1, 0.0123, 0.21]
    assert (np.abs(off) < 3.0 * size).all()


def test_more_missed_flights_than_pieces_may_be_left_out_give_a_wider_mode_or_none(tmp_path: Path) -> None:
    """Each tears the ringing; what stays unexplained is in the standard deviations."""
    hidden = {"table_resonance.hz": 5.1, "table_resonance.damping": 0.0123, "table_resonance.ratio": 0.21}
    mode = _found(tmp_path, hidden, missed=range(60, 460, 40))
    assert mode is None or abs(mode.frequency_hz - 5.1) < 4.0 * mode.sigmas()[0]


def test_no_mode_is_found_where_only_a_friction_is_hidden(tmp_path: Path) -> None:
    """A friction does not look like a ringing plate."""
    assert _found(tmp_path, {"coulomb_friction.mu": 0.05}) is None


def test_the_answer_of_a_mode_is_that_of_its_differential_equation() -> None:
    """Block means of the acceleration after a step of the push, against the closed form of the speed."""
    w, damping, block_s = 2.0 * np.pi * 5.0, 0.1, 5e-4
    push = np.concatenate([np.zeros(10), np.ones(400)])
    time_s = np.maximum(np.arange(411) - 10, 0) * block_s
    own = w * np.sqrt(1.0 - damping**2)
    speed = np.exp(-damping * w * time_s) * np.sin(own * time_s) / own
    np.testing.assert_allclose(answer(push, block_s, 5.0, damping), np.diff(speed) / block_s, atol=1e-9)


def test_no_mode_is_found_where_the_drive_stands_still(tmp_path: Path) -> None:
    """A channel of zeros explains no acceleration, and ends no verdict."""
    assert _found(tmp_path, {"coulomb_friction.mu": 0.05}, drive_share=0.0) is None


def test_a_mode_at_the_least_damping_is_none() -> None:
    """What fits best with next to no damping is a plate that the ball loads, or whose drive swells, and no mode."""
    rng, n = np.random.default_rng(5), 8000
    push, known = 10.0 * rng.standard_normal(n), np.ones(n, dtype=np.bool_)
    for damping, is_mode in ((1e-3, False), (0.01, True)):
        acceleration = 0.1 * answer(push, 1e-3, 5.0, damping) + 0.01 * rng.standard_normal(n)
        seen = _Regression.of(acceleration, np.zeros((n, 1)), push, known, 1e-3, [0])
        assert (seen.judged(np.log([5.0, damping]), 25.0) is not None) == is_mode
