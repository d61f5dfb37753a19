"""Three ways to measure the restitution of an elastic ball on a shaken plate, on the simulated rig (published.md)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from analysis.flights.assemble import flights_of
from analysis.flights.table import FlightFlag, Flights
from bench.jobs.run_ramp import record
from bench.profiles.edit import with_values
from bench.profiles.find import load
from daq.recording import open_recording
from rig.backends.simulated import SimulatedBackend
from rig.profile import parse_profile
from rig.sim.scenario import Scenario

E0 = 0.7
CAUGHT = (1.6, 1.1, 1.62, 1.1, 1.64, 1.1)  # gamma_peak: from disorder into the locked cycle, by chance in a few tries
DOWN = (1.0, 0.9, 0.8, 0.7, 0.6, 0.57, 0.56, 0.55, 0.54)
G_MPS2 = 9.80665


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Flights:
    """Flights of a ball of restitution 0.7, caught in its locked cycle at 1.1, then ramped down until it falls out."""
    path = tmp_path_factory.mktemp("elastic") / "run.h5"
    values = {
        "ramp": {"gamma": [0.5 * peak for peak in CAUGHT + DOWN], "settle_cycles": 60, "hold_cycles": 40,
                 "slew_per_cycle": 0.5},
        "limits.contact_cycles": 0,
    }  # fmt: skip
    text = with_values(load("simulated")[1], values, "elastic")
    rig = SimulatedBackend(20_000, Scenario("elastic", {"restitution": {"e0": E0}}), 1)
    assert record(parse_profile(text, "elastic"), text, rig, path, quiet=True).how == "complete"
    with open_recording(path) as opened:
        return flights_of(opened)


def of_step(flights: Flights, step: int) -> tuple[Flights, float, float]:
    """True flights in the hold of a step, its gamma_peak and w."""
    plate = flights.plate.steps[step]
    assert plate is not None
    poor = FlightFlag.FALSE | FlightFlag.CUT | FlightFlag.SETTLING
    return flights.select((flights.step == step) & ~flights.has(poor)), 2.0 * plate.gamma, plate.omega_radps


def test_speeds_before_and_after_each_impact_give_it_within_a_thousandth(flights: Flights) -> None:
    """In disorder: speeds off the plate before and after, from times and places of successive impacts; their slope."""
    found = []
    for step in (0, 2, 4):
        own, peak, omega = of_step(flights, step)
        size_m = peak * G_MPS2 / omega**2
        rise = size_m * (np.sin(own.landing_phase) - np.sin(own.takeoff_phase)) / own.duration_s
        half = 0.5 * G_MPS2 * own.duration_s
        plate = size_m * omega * np.cos(own.landing_phase[:-1])
        before, after = plate - (rise - half)[:-1], (rise + half)[1:] - plate
        near = own.takeoff_s[1:] - own.landing_s[:-1] < 2e-3
        found.append((before[near] @ after[near]) / (before[near] @ before[near]))
    assert np.mean(found) == pytest.approx(E0, abs=1e-3)


def test_the_phase_of_the_locked_cycle_gives_it_within_a_thousandth(flights: Flights) -> None:
    """gamma_peak cos phi = pi (1 - e) / (1 + e) at the impacts of the locked flight of one period."""
    own, peak, _ = of_step(flights, len(CAUGHT))
    work = peak * np.cos(own.takeoff_phase)
    found = (math.pi - work) / (math.pi + work)
    assert len(own) > 30 and float(np.median(found)) == pytest.approx(E0, abs=1e-3)


def test_the_least_drive_of_the_locked_cycle_gives_it_too_low(flights: Flights) -> None:
    """On the way down the cycle is lost at or above gamma_peak = pi (1 - e) / (1 + e): e is never found too high."""
    alive = [
        of_step(flights, step)[1]
        for step in range(len(CAUGHT), len(CAUGHT + DOWN))
        if len(of_step(flights, step)[0]) > 30
    ]
    least = min(alive)
    found = (math.pi - least) / (math.pi + least)
    assert least >= math.pi * (1.0 - E0) / (1.0 + E0) - 1e-3
    assert E0 - 0.02 < found < E0 + 1e-3
