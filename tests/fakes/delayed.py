"""A device that answers late: the simulated rig behind buffers, as a sound card has them."""

from __future__ import annotations

import numpy as np

from daq.files.tables import Block
from kernels.arrays import Floats
from rig.backends.simulated import SimulatedBackend


class Delayed(SimulatedBackend):
    """Frames lie ``lag_samples`` behind the drive that was handed over."""

    lag_samples = 0.0

    def behind(self, lag_samples: int) -> Delayed:
        """This device, so late."""
        self.lag_samples = float(lag_samples)
        return self

    def start(self) -> None:
        super().start()
        self._waiting = np.zeros(round(self.lag_samples))

    def exchange(self, drive_v: Floats) -> Block:
        waiting = np.concatenate([self._waiting, drive_v])
        self._waiting = waiting[len(drive_v) :]
        return super().exchange(waiting[: len(drive_v)])
