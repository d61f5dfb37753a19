"""A plate mode as it moved in a recording, in place of a chain of predictions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import flights_of
from analysis.plate.ringing.modes import Identified
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.observations import Observations, observed
from analysis.residuals.values import TREND
from benchmarks.plants import other_plant
from benchmarks.plants.handed_over import imported
from benchmarks.plants.instrument import Instrument
from daq.recording import open_recording

HZ, DAMPING, RATIO = 8.2, 0.0104, 0.2
VALUES = {
    ("table_resonance", "mass_ratio"): RATIO,
    ("table_resonance", "frequency_hz"): HZ,
    ("table_resonance", "damping"): DAMPING,
}


def _recorded(folder: Path, **more: float) -> Path:
    """A recording over a ringing plate, with what else is hidden."""
    hidden = {"table_resonance.hz": HZ, "table_resonance.damping": DAMPING, "table_resonance.ratio": RATIO, **more}
    gammas = np.random.default_rng(2).permutation(np.round(np.linspace(0.5, 2.6, 16), 4))
    run = other_plant.Run(hidden=hidden, seed=2, gammas=tuple(gammas.tolist()), spikes=True, closure_s=5e-4)
    path: Path = imported(other_plant.simulate(run), other_plant.profile_of(run), folder)
    return path


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Observations, Observations]:
    """A recording over a ringing plate, with its mode identified and without."""
    path = _recorded(tmp_path_factory.mktemp("ringing"))
    with open_recording(path) as recording:
        flights = flights_of(recording)
        return observed(recording, flights), observed(recording, flights, with_mode=False)


def _missed_us(seen: Observations) -> float:
    left = ForwardModel(seen, {}).residuals(VALUES).landing_s
    return 1e6 * float(np.median(np.abs(left[np.isfinite(left)])))


def test_landings_over_a_plate_as_it_moved_are_missed_by_less(both: tuple[Observations, Observations]) -> None:
    """A long-lived mode that is followed from flight to flight carries the errors of all impacts with it."""
    seen, _ = both
    assert _missed_us(seen) < 0.5 * _missed_us(replace(seen, ringing=Identified()))


def test_a_light_slow_mode_makes_landings_less_sure(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What the accelerometer leaves unknown of a mode's motion counts: landings are missed by as much as is stated."""
    hidden = {"table_resonance.hz": 5.3, "table_resonance.damping": 0.04, "table_resonance.ratio": 0.045}
    hidden["restitution.e0"] = 0.12
    gammas = np.random.default_rng(5).permutation(np.round(np.linspace(0.6, 2.0, 14), 4))
    run = other_plant.Run(hidden=hidden, seed=5, gammas=tuple(gammas.tolist()), closure_s=5e-4, instrument=Instrument())
    path: Path = imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path_factory.mktemp("light"))
    with open_recording(path) as recording:
        model = ForwardModel(observed(recording, flights_of(recording)), {})
    values = dict(zip(VALUES, (0.045, 5.3, 0.04), strict=True)) | {("restitution", "e0"): 0.12}
    left, sigma = model.residuals(values).landing_s, uncertainty_at(model, values).landing_total_s
    z = (left / sigma)[np.isfinite(left)]
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3


def test_what_rings_is_no_noise_of_the_plates_tones(both: tuple[Observations, Observations]) -> None:
    """The tones are known better once the mode is."""
    seen, blind = both
    assert seen.steps.sigma_mps2[:, 0].max() < 0.5 * blind.steps.sigma_mps2[:, 0].max()


def _second_harmonics(seen: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Of each step that has one: whether it is all the mode's, and what drives the plate there at `VALUES`, m/s^2."""
    model, plate = ForwardModel(seen, {}), seen.steps.plate
    mode = model.measured_mode(model.rows(VALUES))
    assert mode is not None
    at = np.abs(plate.omega_radps * plate.period_s[:, None] / (4.0 * np.pi) - 1.0) < 1e-3
    return mode.undriven[at], np.abs(plate.acceleration_mps2 - mode.mode_amplitudes)[at]


def test_a_harmonic_that_only_the_mode_makes_drives_nothing(
    both: tuple[Observations, Observations], tmp_path: Path
) -> None:
    """The noise of a harmonic of which the mode leaves nothing is no motion of the plate; a drive's trace of one is."""
    undriven, left_mps2 = _second_harmonics(both[0])
    assert len(undriven) > 10 and undriven.all() and left_mps2.max() < 1e-9
    with open_recording(_recorded(tmp_path, **{"harmonic_distortion.second": 0.001})) as recording:
        undriven, left_mps2 = _second_harmonics(observed(recording, flights_of(recording)))
    assert not undriven.any() and np.median(left_mps2) > 0.004


def test_a_mode_that_drifts_is_followed_from_flight_to_flight(both: tuple[Observations, Observations]) -> None:
    """The motion is that of one mode of a recording."""
    model = ForwardModel(both[0], {})
    assert model.measured_mode(model.rows(VALUES)) is not None
    drifting = {**VALUES, ("table_resonance", "mass_ratio" + TREND): 0.1}
    assert model.measured_mode(model.rows(drifting)) is None


def test_a_mode_moves_the_same_where_something_beside_it_drifts(both: tuple[Observations, Observations]) -> None:
    """A calibration that drifts by nothing changes no landing: else any drift would gain what two motions differ by."""
    model = ForwardModel(both[0], {})
    beside = {**VALUES, ("accelerometer_gain", "relative" + TREND): 1e-12}
    without, with_it = (model.residuals(x).landing_s for x in (VALUES, beside))
    assert with_it == pytest.approx(without, abs=1e-9, nan_ok=True)


@pytest.fixture(scope="module")
def bounced(tmp_path_factory: pytest.TempPathFactory) -> tuple[Observations, np.ndarray]:
    """A ball that bounces on a ringing plate, behind an accelerometer with a bias; by how much landings are missed."""
    values = {"hz": 8.8, "damping": 0.29, "ratio": 0.09}
    hidden = {f"table_resonance.{k}": v for k, v in values.items()} | {"restitution.e0": 0.212}
    gammas = np.random.default_rng(3).permutation(np.round(np.linspace(0.9, 1.9, 8), 4))
    run = other_plant.Run(
        hidden=hidden, seed=3, gammas=tuple(gammas.tolist()), closure_s=5e-4, instrument=Instrument(bias_v=0.01)
    )
    path: Path = imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path_factory.mktemp("bounced"))
    with open_recording(path) as recording:
        seen = observed(recording, flights_of(recording))
    names = ("frequency_hz", "damping", "mass_ratio")
    true = {("table_resonance", k): v for k, v in zip(names, values.values(), strict=True)}
    return seen, ForwardModel(seen, {}).residuals({**true, ("restitution", "e0"): 0.212}).landing_s


def test_what_a_ball_gives_the_plate_as_it_leaves_comes_back_with_it(bounced: tuple[Observations, np.ndarray]) -> None:
    """Flights from rest, which follow rebounds that no instrument shows, have no bias, nor have those after them."""
    seen, missed_s = bounced
    long = seen.measured.landing_s - seen.measured.opening_s > 3e-3
    of = seen.scored & ~seen.measured.relaunched & long & np.isfinite(missed_s)
    assert of.sum() > 30 and abs(np.median(missed_s[of])) < 15e-6
    after = np.append(False, of[:-1]) & seen.scored & seen.measured.relaunched & np.isfinite(missed_s)
    assert after.sum() > 10 and abs(np.median(missed_s[after])) < 8e-6


def test_no_zero_of_the_accelerometer_is_needed_over_a_plate_as_it_moved(
    bounced: tuple[Observations, np.ndarray],
) -> None:
    """Flights next to a fade of the drive are predicted as well as the others."""
    seen, missed_s = bounced
    near = np.isfinite(seen.measured.gained_mps) & seen.scored & np.isfinite(missed_s)
    assert near.sum() > 5 and np.median(np.abs(missed_s[near])) < 50e-6


def test_take_offs_from_a_plate_that_rings_are_not_taken_for_a_late_contact(tmp_path: Path) -> None:
    """A friction and a light mode move take-offs as a contact that opens 55 us late would."""
    hidden = {"table_resonance.hz": 6.6, "table_resonance.damping": 0.075, "table_resonance.ratio": 0.02}
    hidden["coulomb_friction.mu"] = 0.05
    gammas = np.random.default_rng(5).permutation(np.round(np.linspace(0.5, 2.6, 18), 4))
    run = other_plant.Run(
        hidden=hidden, seed=5, gammas=tuple(gammas.tolist()), closure_s=1e-4, instrument=Instrument(), bits=16
    )
    path = imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path)
    with open_recording(path) as recording:
        seen = observed(recording, flights_of(recording))
    assert seen.ringing.mode is not None
    assert not any("circuit opens" in note for note in seen.notes)


LATE_S, SOFT = 2.0**0.5 / (2.0 * np.pi * 1e3), (3.5, 0.15, 0.15)


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> tuple[ForwardModel, dict[tuple[str, str], float]]:
    """A soft plate under flights after rests of a millisecond, behind a low-pass of 1 kHz; its true values."""
    hidden = dict(zip(("table_resonance.hz", "table_resonance.damping", "table_resonance.ratio"), SOFT, strict=True))
    gammas = np.random.default_rng(4).permutation(np.round(np.linspace(0.6, 1.4, 12), 4))
    run = other_plant.Run(
        c=2,
        hidden=hidden,
        seed=4,
        gammas=tuple(gammas.tolist()),
        closure_s=1e-4,
        instrument=Instrument(low_pass_hz=1e3),
    )
    path = imported(other_plant.simulate(run), other_plant.profile_of(run), tmp_path_factory.mktemp("late"))
    with open_recording(path) as recording:
        model = ForwardModel(observed(recording, flights_of(recording)), {})
    names = ("frequency_hz", "damping", "mass_ratio")
    true = {("table_resonance", k): v for k, v in zip(names, SOFT, strict=True)}
    return model, {**true, ("accelerometer_lag", "delay_s"): LATE_S}


def test_a_ball_that_lies_for_a_millisecond_presses_the_plate_once(
    late: tuple[ForwardModel, dict[tuple[str, str], float]],
) -> None:
    """Flights that seem to begin at once, and do not, are predicted as well as those after a rest that was seen."""
    model, true = late
    left, seen = model.residuals(true), model.observations.measured
    stayed = seen.relaunched & (left.predicted.kind == 0.0) & np.isfinite(left.landing_s)
    assert stayed.sum() > 8
    z = left.landing_s / uncertainty_at(model, true).landing_total_s
    assert np.sqrt(np.mean(z[stayed] ** 2)) < 1.5


def test_a_late_accelerometer_shows_the_mode_late_too(
    late: tuple[ForwardModel, dict[tuple[str, str], float]],
) -> None:
    """What the drive does not ask for is the mode's: its harmonics, taken as late as the drive's, leave nothing."""
    model, true = late
    plate = model.observations.steps.plate
    added = model.predicted(true).mode_amplitudes
    k = np.abs(plate.omega_radps[:, : added.shape[1]] / (2.0 * np.pi) - 3.0 * 25.37) < 0.1
    own = k & (plate.acceleration_mps2[:, : k.shape[1]] != 0.0)
    shown = (plate.acceleration_mps2 / model.reading(true))[:, : k.shape[1]][own]
    assert own.sum() > 5
    assert np.angle(np.vdot(added[own], shown)) == pytest.approx(0.0, abs=0.02)
