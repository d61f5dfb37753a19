"""The simulated back end: `rig.sim.plant.Plant` behind the interface of a device, at full speed or paced.

Pacing changes when a block comes, never what is in it.
"""

from __future__ import annotations

import time
from collections.abc import Collection

import numpy as np

from daq.files.tables import Block
from kernels.arrays import Floats
from rig.backends.base import BackendError, checked_drive
from rig.backends.kinds.base import OpenOptions
from rig.profile import Profile
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario, load_scenario


class SimulatedBackend:
    """A simulated rig.

    Parameters
    ----------
    rate_hz
        Samples a second.
    scenario
        What the rig hides; the recording gets only its hash.
    seed
        Of the sensors' noise and the contact's bounce.
    real_time
        Whether a block takes as long as it lasts.
    further
        As of `rig.sim.plant.Plant`.

    Attributes
    ----------
    drive_v : float
        Drive at the amplifier now: the last sample played, 0 before the start and after the stop.
    """

    name = "simulated"
    simulated = True

    def __init__(
        self, rate_hz: float, scenario: Scenario, seed: int, *, real_time: bool = False, further: Collection[str] = ()
    ) -> None:
        self.rate_hz = rate_hz
        self.scenario_sha256: str | None = scenario.sha256
        self._scenario, self._seed, self._real_time, self._further = scenario, seed, real_time, further
        self._running = False
        self._began_ns = 0
        self._new_plant()

    def _new_plant(self) -> None:
        rng = np.random.default_rng(self._seed)
        self._plant = Plant(self._scenario, self.rate_hz, rng, further=self._further)
        self.channels = self._plant.channels
        self.scales = {name: (scale, 0.0) for name, scale in self._plant.channel_scales.items()}
        self._n_samples = 0
        self.drive_v = 0.0

    def start(self) -> None:
        """A plate at rest with the ball on it; starting again starts over, with the same noise."""
        self._new_plant()
        self._running = True
        self._began_ns = time.monotonic_ns()

    def exchange(self, drive_v: Floats) -> Block:
        """Move the plant by ``drive_v`` (n,) and return what its converters read (raises BackendError: not started)."""
        drive = checked_drive(drive_v)
        if not self._running:
            raise BackendError("not started")
        first = self._n_samples
        codes = self._plant.exchange(drive)
        self.drive_v = float(drive[-1]) if len(drive) else self.drive_v
        self._n_samples += len(codes)
        if self._real_time:
            due_ns = self._began_ns + round(self._n_samples / self.rate_hz * 1e9)
            time.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)
        return Block(first_sample=first, codes=codes, flags=0, clock_ns=time.monotonic_ns(), lost_before=0)

    def turn(self, over: bool) -> None:
        """Lay the accelerometer upside down, or back: what a person does for a flip test; starting lays it back."""
        self._plant.turn(over)

    def stop(self) -> None:
        """Leave the drive at 0 V and the plate at rest."""
        self._running, self.drive_v = False, 0.0


def open_simulated(profile: Profile, options: OpenOptions) -> SimulatedBackend:
    """A simulated rig at the profile's rate, ideal where no scenario is given."""
    scenario = Scenario("ideal") if options.scenario is None else load_scenario(options.scenario)
    return SimulatedBackend(
        profile.sampling.rate_hz, scenario, options.seed, real_time=options.real_time,
        further=profile.channels.recorded(),
    )  # fmt: skip
