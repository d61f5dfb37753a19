"""The flip test gives back what the simulated rig hides of its accelerometer, or says why it cannot."""

from __future__ import annotations

import numpy as np
import pytest

from bench.profiles.find import load
from daq.files.tables import Block
from rig.backends.simulated import SimulatedBackend
from rig.checks.flip_test import flip_test
from rig.profile import Profile
from rig.sim.scenario import Scenario

HIDDEN = {"accelerometer_gain": {"relative": 0.04}, "accelerometer_offset": {"offset_g": 0.15}}


def profile_for(reads_gravity: bool) -> Profile:
    """The shipped profile, its accelerometer DC-coupled and zeroed as mounted, or not."""
    profile, _ = load("simulated")
    sensor = profile.channels.accelerometer.model_copy(update={"reads_gravity": reads_gravity})
    return profile.model_copy(update={"channels": profile.channels.model_copy(update={"accelerometer": sensor})})


def nobody(over: bool) -> None:
    """A rig that turns its own sensor asks nobody."""
    raise AssertionError("asked a person to turn the sensor")


@pytest.mark.parametrize("reads_gravity", [False, True])
def test_scale_and_offset_are_the_hidden_ones(reads_gravity: bool) -> None:
    """Over ten seeds both values lie within three of their uncertainties, which are below a thousandth."""
    scenario = Scenario("hidden", HIDDEN, {"accelerometer_reads_gravity": float(reads_gravity)})
    for seed in range(10):
        found = flip_test(profile_for(reads_gravity), SimulatedBackend(20000.0, scenario, seed), nobody)
        assert abs(found.sensitivity - 0.104) < 3 * found.sensitivity_uncertainty < 3e-4
        assert abs(found.offset_v - 0.015) < 3 * found.offset_uncertainty_v < 3e-4


def test_readings_scatter_as_they_say() -> None:
    """The offset's error over forty seeds scatters by what it claims, neither half nor twice as much."""
    scenario = Scenario("hidden", HIDDEN)
    found = [flip_test(profile_for(False), SimulatedBackend(20000.0, scenario, seed), nobody) for seed in range(40)]
    pulls = np.array([(one.offset_v - 0.015) / one.offset_uncertainty_v for one in found])
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.5


class ByHand:
    """A rig whose sensor only a person can turn; ``feels`` is what of gravity it shows."""

    name, simulated, scenario_sha256 = "by hand", False, None

    def __init__(self, feels: float) -> None:
        self._rig = SimulatedBackend(20000.0, Scenario("ideal"), 1)
        self.channels, self.rate_hz, self.scales = self._rig.channels, self._rig.rate_hz, self._rig.scales
        self.asked: list[bool] = []
        self._feels, self.running = feels, False

    def ask(self, over: bool) -> None:
        """The person; never while the device runs."""
        assert not self.running
        self.asked.append(over)

    def start(self) -> None:
        """Start the rig."""
        self._rig.start()
        self.running = True

    def exchange(self, drive_v: np.ndarray) -> Block:
        """Its frames, the sensor as it lies; nothing may be driven."""
        assert not drive_v.any()
        block = self._rig.exchange(drive_v)
        block.codes[:, 1] += round(-2.0 * self._feels * self.asked[-1] * 0.1 / self.scales["accelerometer"][0])
        return block

    def stop(self) -> None:
        """Stop the rig."""
        self._rig.stop()
        self.running = False


def test_a_person_turns_a_real_sensor() -> None:
    """On a rig that cannot turn its sensor a person is asked for each orientation, the device being off meanwhile."""
    rig = ByHand(1.0)
    found = flip_test(profile_for(False), rig, rig.ask)
    assert rig.asked == [False, True, False] and not rig.running
    assert found.sensitivity == pytest.approx(0.1, abs=3 * found.sensitivity_uncertainty + 1e-4)


def test_a_sensor_that_does_not_feel_gravity_is_refused() -> None:
    """A charge amplifier shows nothing when turned: said, with both readings, instead of a scale."""
    rig = ByHand(0.01)
    with pytest.raises(ValueError, match="does not feel gravity"):
        flip_test(profile_for(False), rig, rig.ask)
