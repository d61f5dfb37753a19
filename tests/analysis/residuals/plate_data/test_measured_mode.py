"""A plate mode as it moved in a recording, in place of a chain of predictions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import flights_of
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.observations import Observations, observed
from analysis.residuals.values import TREND
from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported
from daq.recording import open_recording

HZ, DAMPING, RATIO = 8.2, 0.0104, 0.2
VALUES = {
    ("table_resonance", "mass_ratio"): RATIO,
    ("table_resonance", "frequency_hz"): HZ,
    ("table_resonance", "damping"): DAMPING,
}


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Observations, Observations]:
    """A recording over a ringing plate, with its mode identified and without."""
    hidden = {"table_resonance.hz": HZ, "table_resonance.damping": DAMPING, "table_resonance.ratio": RATIO}
    gammas = np.random.default_rng(2).permutation(np.round(np.linspace(0.5, 2.6, 16), 4))
    run = other_plant.Run(hidden=hidden, seed=2, gammas=tuple(gammas.tolist()), spikes=True, closure_s=5e-4)
    path: Path = imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path_factory.mktemp("ringing"))
    with open_recording(path) as recording:
        flights = flights_of(recording)
        return observed(recording, flights), observed(recording, flights, with_mode=False)


def _missed_us(seen: Observations) -> float:
    left = ForwardModel(seen, {}).residuals(VALUES).landing_s
    return 1e6 * float(np.median(np.abs(left[np.isfinite(left)])))


def test_landings_over_a_plate_as_it_moved_are_missed_by_less(both: tuple[Observations, Observations]) -> None:
    """A long-lived mode that is followed from flight to flight carries the errors of all impacts with it."""
    seen, _ = both
    assert _missed_us(seen) < 0.5 * _missed_us(replace(seen, pushed=()))


def test_what_rings_is_no_noise_of_the_plates_tones(both: tuple[Observations, Observations]) -> None:
    """The tones are known better once the mode is."""
    seen, blind = both
    assert seen.steps.sigma_mps2[:, 0].max() < 0.5 * blind.steps.sigma_mps2[:, 0].max()


def test_a_mode_that_drifts_is_followed_from_flight_to_flight(both: tuple[Observations, Observations]) -> None:
    """The motion is that of one mode of a recording."""
    model = ForwardModel(both[0], {})
    assert model.measured_mode(model.rows(VALUES)) is not None
    drifting = {**VALUES, ("table_resonance", "mass_ratio" + TREND): 0.1}
    assert model.measured_mode(model.rows(drifting)) is None
