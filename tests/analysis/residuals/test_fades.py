"""Flights in the fade from step to step: which motions the plate's lies between, and how it then rings in the hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import shakerbench as sb
from analysis.flights.assemble import flights_of
from analysis.plate.ringing.modes import Identified
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.held import Fades, with_pushes
from analysis.residuals.observations import Observations, observations_from
from daq.recording import Recording, open_recording
from model.integrator.problem import Measured
from model.tones import STANDARD_GRAVITY_MPS2

MODE = {"table_resonance": {"frequency_hz": 7.5, "damping": 0.04, "mass_ratio": 0.03}}


def test_a_flight_in_a_fade_belongs_to_two_steps() -> None:
    """Before half of a fade the next step has the small share, after it the step before; none in a hold or in rest."""
    fades = Fades(np.array([0.0, 2.0, 4.0]), np.array([1.0, 1.0, 0.0]), np.zeros(3))
    step, time_s = np.array([0, 0, 0, 1, 1, 2]), np.array([0.5, 1.5, 2.25, 2.75, 3.5, 4.1])
    other, share = fades.others(step, time_s)
    assert share == pytest.approx([0.5, 0.0, 0.15625, 0.15625, 0.0, 0.0])
    assert other[[0, 2, 3]].tolist() == [-1, 1, 0]
    assert fades.before_half(np.array([1, 1, 0]), np.array([2.4, 2.6, 0.1])).tolist() == [True, False, False]


def test_flights_before_a_fade_are_read_only_where_it_may_have_begun_there() -> None:
    """The rig's own table says when the drive began to change; a fade found in a drive may have begun by its length
    earlier."""
    own = Fades(np.array([2.0]), np.array([1.0]), np.zeros(1))
    found = replace(own, earlier_s=own.length_s)
    opening_s, landing_s = np.array([0.5, 1.5, 1.9, 2.5, 3.1]), np.array([0.9, 1.8, 2.1, 2.8, 3.3])
    assert own.touch(opening_s, landing_s).tolist() == [False, False, True, True, False]
    assert found.touch(opening_s, landing_s).tolist() == [False, True, True, True, False]


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
    recorded = observations_from([path])
    observations = replace(recorded, ringing=Identified())  # the mode is flown, not read
    unread = replace(observations.measured, gained_mps=None, pressed_mps=None, pressed_at=None)
    abrupt = replace(observations, measured=replace(unread, other_step=None, share=None))
    assert scatter_us(replace(observations, measured=unread)) < 8.0
    assert scatter_us(abrupt) > 3.0 * scatter_us(replace(observations, measured=unread))
    assert scatter_us(observations) < 8.0
    assert scatter_us(recorded) < 8.0


def test_a_fade_found_too_long_does_not_matter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps found in a drive give fades of the wrong length; the accelerometer tells how the plate was struck there."""
    values = {"ramp.gamma": [1.1, 2.3, 1.4, 2.0], "ramp.settle_cycles": 20, "ramp.hold_cycles": 12}
    path = tmp_path / "ringing.h5"
    sb.run(sb.load_profile("simulated").with_values(values), path, scenario="resonance", seed=6)
    exact = Fades.of

    def found(recording: Recording) -> Fades:
        twice_s = 2.0 * exact(recording).length_s
        return replace(exact(recording), length_s=twice_s, earlier_s=twice_s)

    monkeypatch.setattr(Fades, "of", found)
    observations = replace(
        observations_from([path]), ringing=Identified()
    )  # the mode is followed from flight to flight
    unread = replace(observations.measured, gained_mps=None, pressed_mps=None, pressed_at=None)
    assert scatter_us(observations) < 6.0
    assert scatter_us(replace(observations, measured=unread)) > 2.0 * scatter_us(observations)


def test_the_accelerometer_tells_what_a_plate_gives_a_ball(tmp_path: Path) -> None:
    """Acceleration plus gravity, integrated over a flight and over the contact before it, as the plate's tones have it;
    an accelerometer whose offset is not stated tells nothing."""
    values = {"ramp.gamma": [1.3, 1.4], "ramp.settle_cycles": 8, "ramp.hold_cycles": 12}
    path = tmp_path / "ideal.h5"
    sb.run(sb.load_profile("simulated").with_values(values), path, seed=7)
    with open_recording(path) as recording:
        flights = flights_of(recording)
        hold = Fades(np.array([0.0]), np.array([recording.n_samples / recording.rate_hz]), np.zeros(1))
        rows = np.flatnonzero((flights.flags == 0) & (flights.step == 1))
        true = np.ones(len(rows), dtype=bool)
        bare = Measured(flights.takeoff_s[rows], flights.landing_s[rows], ~true, true, flights.step[rows], true)
        found = with_pushes(bare, recording, flights, hold, rows)
        channel = recording.setup.channels.accelerometer.model_copy(update={"offset_v": None})
        channels = recording.setup.channels.model_copy(update={"accelerometer": channel})
        recording.measure_with(recording.setup.model_copy(update={"channels": channels}))
        assert np.isnan(with_pushes(bare, recording, flights, hold, rows).gained_mps).all()
    for i in np.flatnonzero(np.diff(rows) == 1) + 1:
        opening, landing, before = (
            flights.takeoff_s[rows[i]],
            flights.landing_s[rows[i]],
            flights.landing_s[rows[i - 1]],
        )
        for value, a, b in ((found.gained_mps[i], opening, landing), (found.pressed_mps[i], before, opening)):
            time_s = np.linspace(a, b, 400)
            at = flights.plate.acceleration_mps2(time_s, np.full(400, flights.step[rows[i]]))
            assert value == pytest.approx(np.trapezoid(at + STANDARD_GRAVITY_MPS2, time_s), abs=0.01)
