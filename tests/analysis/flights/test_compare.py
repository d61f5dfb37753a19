"""Declared effects of plate and instruments, in a comparison and in a profile given to it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from analysis.flights.assemble import flights_of
from analysis.flights.compare import compare, first_bifurcation, seen_open
from daq.recording import open_recording
from daq.setup.errors import InputError
from model.effects.registry import accelerometer_response, ball_effects, plate_gain, shapes_the_plate


def test_each_effect_acts_in_one_place() -> None:
    """Ball, drive and accelerometer are distinguished by what the effects' own files define."""
    effects = {
        "coulomb_friction": {"mu_up": 0.1},
        "drive_gain": {"relative": 0.1},
        "gain_compression": {"per_g2": 0.05},
        "accelerometer_gain": {"relative": 0.2},
        "mains_hum": {"amplitude_mps2": 0.1},
        "accelerometer_lag": {"low_pass_s": 1e-3},
        "mains_pickup": {"amplitude_mps2": 0.1},
        "contact_latency": {},
    }
    omega_radps = np.array([60.0, 120.0])
    assert list(ball_effects(effects)) == ["coulomb_friction"]
    assert plate_gain(effects, 2.0) == pytest.approx(1.1 / 1.2)
    assert accelerometer_response(effects, omega_radps) == pytest.approx(1.2 / (1.0 + 1e-3j * omega_radps))
    assert shapes_the_plate(effects) == ["mains_hum"]


def test_a_declared_accelerometer_gain_corrects_the_comparison(make: Callable[..., Any]) -> None:
    """An accelerometer 6 % too sensitive: flights look short, and as long as they should once that is declared."""
    rig = {"accelerometer_gain": {"relative": 0.06}, "drive_gain": {"relative": 0.05}}
    made = make(np.array([0.7, 0.9, 1.1, 1.3]), hold=16, effects=rig)
    with open_recording(made.path) as recording:
        flights = flights_of(recording)
        bare = compare(flights, recording.setup, steps_table=recording.steps)
        told = compare(flights, recording.setup, effects=rig, steps_table=recording.steps)
    assert bare.short_by > 0.015
    assert abs(told.short_by) < 0.001
    assert told.within_sample == 1.0
    assert told.effects == ("accelerometer_gain", "drive_gain")


def test_the_first_bifurcation_alone_is_that_of_the_comparison(make: Callable[..., Any]) -> None:
    """Who wants the first bifurcation only gets the comparison's, without the motion in each step."""
    made = make(np.array([0.26, 0.28, 0.32, 0.34]), ratio=2, hold=16)
    with open_recording(made.path) as recording:
        flights = flights_of(recording)
        whole = compare(flights, recording.setup, effects={}, steps_table=recording.steps).first
        alone = first_bifurcation(flights, recording.setup, {})
    assert alone.predicted_type
    assert (alone.measured, alone.predicted_type, alone.predicted_gamma) == (
        whole.measured, whole.predicted_type, whole.predicted_gamma
    )  # fmt: skip


def test_another_profile_reads_the_same_volts(make: Callable[..., Any]) -> None:
    """Given a profile with twice the sensitivity the plate has half the motion; one with another c is refused."""
    made = make(np.array([0.6, 0.8]))
    with open_recording(made.path) as recording:
        before = [s.gamma for s in flights_of(recording).plate.steps if s is not None]
        sensor = recording.setup.channels.accelerometer
        twice = sensor.model_copy(update={"sensitivity": sensor.sensitivity.model_copy(update={"value": 0.2})})
        channels = recording.setup.channels.model_copy(update={"accelerometer": twice})
        recording.measure_with(recording.setup.model_copy(update={"channels": channels}))
        after = [s.gamma for s in flights_of(recording).plate.steps if s is not None]
        assert after == pytest.approx([g / 2 for g in before])
        other = recording.setup.model_copy(update={"forcing": recording.setup.forcing.model_copy(update={"ratio": 2})})
        with pytest.raises(InputError, match=r"c = 1"):
            recording.measure_with(other)


def test_an_integrated_ball_has_the_bifurcation_of_the_exact_one(make: Callable[..., Any]) -> None:
    """With a trace of viscous damping the model is integrated; its first change is the lock, at the same gamma."""
    made = make(np.array([0.55, 0.9, 1.3, 1.7]), hold=12)
    with open_recording(made.path) as recording:
        flights = flights_of(recording)
        exact = compare(flights, recording.setup, steps_table=recording.steps)
        trace = {"viscous_damping": {"rate_per_s": 1e-4}}
        integrated = compare(flights, recording.setup, effects=trace, steps_table=recording.steps)
    assert exact.first.predicted_type == integrated.first.predicted_type == "lock"
    assert integrated.first.predicted_gamma == pytest.approx(exact.first.predicted_gamma, abs=2e-4)


def test_a_plate_at_a_million_g_is_not_compared(make: Callable[..., Any]) -> None:
    """A plate beyond any shaker is refused with the scale to check, not computed for minutes."""
    with open_recording(make(np.array([0.6, 0.8])).path) as recording:
        flights, setup = flights_of(recording), recording.setup
    steps = (None, replace(flights.plate.steps[1], gamma=1e6))
    wrong = replace(flights, plate=replace(flights.plate, steps=steps))
    with pytest.raises(ValueError, match=r"step 1: the accelerometer reads gamma = 1e\+06.*sensitivity"):
        compare(wrong, setup)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(1_000_000, 5_000_000_000) | st.integers(1, 100).map(lambda n: 50_000_000 * n), min_size=2))
@example([5_000_000_000, 5_000_000_000, 150_000_000, 3_906_250_000])
def test_visible_flights_are_those_of_a_look_at_every_sample(gaps_ps: list[int]) -> None:
    """Flights whose contact in between falls on no sample of 20 kHz are one: as a scan in whole picoseconds finds."""
    times_ps = np.cumsum(gaps_ps[: len(gaps_ps) // 2 * 2])
    takeoff_ps, landing_ps = times_ps[::2], times_ps[1::2]
    first, last = seen_open(takeoff_ps / 1e12, landing_ps / 1e12, 20000.0)
    read_ps = 50_000_000 * np.arange(landing_ps[-1] // 50_000_000 + 3)
    inside = (read_ps[:, None] >= takeoff_ps) & (read_ps[:, None] < landing_ps)
    steps = np.flatnonzero(np.diff(inside.any(axis=1).astype(int))) + 1
    assert list(first) == [int(np.argmax(inside[k])) for k in steps[::2]]
    assert list(last) == [int(np.argmax(inside[k - 1])) for k in steps[1::2]]
