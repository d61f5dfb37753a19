"""The plant behind two drivers: the drive comes by JACK, frames leave by a pseudo-terminal, on a clock of their own.

Between the sound card's clock and the device's there is nothing but the drive's voltage. POSIX
only it has pseudo-terminals: elsewhere this is refused.
"""

from __future__ import annotations

import os
import queue
import select
import threading
from pathlib import Path
from typing import Self

import numpy as np

from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.kinds.soundcard_serial import SoundcardSerialOptions
from rig.profile import Profile
from rig.sim.scenario import Scenario
from rig.virtual.jack import PlantClient
from rig.virtual.serial_device import SerialDevice

HELD_PERIODS = 4  # of frames that the device holds for a reader that is late


class JackSerialPlant(PlantClient):
    """A plant that hears the client ``profile.backend.device`` and sends its frames to a pseudo-terminal.

    Raises `InputError` when there is no such server, it runs at another rate, or the system has no pseudo-terminals.

    Arguments are as of `rig.virtual.jack.JackPlant` and `rig.virtual.serial_device.SerialDevice`.

    Attributes
    ----------
    port : str
        Name of the terminal; ``profile.backend.port`` is a link to it while the block runs.
    device : SerialDevice
    """

    def __init__(
        self, profile: Profile, scenario: Scenario, seed: int, server: str, *, ppm: float, ppm_per_minute: float
    ) -> None:
        if not hasattr(os, "openpty"):
            raise InputError("a virtual serial device needs pseudo-terminals, which this system does not have")
        rate_hz = profile.sampling.rate_hz
        rng = np.random.default_rng(seed)
        further = profile.channels.recorded()
        warm = SerialDevice(scenario, rate_hz, rng.spawn(1)[0], further=further)
        warm.play(np.zeros(256))  # compiled before it counts
        self.device = SerialDevice(scenario, rate_hz, rng, ppm=ppm, ppm_per_minute=ppm_per_minute, further=further)
        if not isinstance(profile.backend, SoundcardSerialOptions):
            raise InputError(f"backend.kind is {profile.backend.kind}; wanted soundcard+serial")
        self._link = Path(profile.backend.port)
        if self._link.exists() or self._link.is_symlink():
            raise InputError(f"backend.port = {str(self._link)!r} is there already; name a path that is not")
        super().__init__(profile, server)
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        # bytes as they are: no echo, no line ends. The module is POSIX's
        import tty

        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._periods: queue.SimpleQueue[Floats | None] = queue.SimpleQueue()
        self._sender = threading.Thread(target=self._send, name="virtual serial", daemon=True)

    def _move(self, drive_v: Floats, frame: int | None) -> None:
        self._periods.put(drive_v)  # the device runs in a thread of its own

    def _send(self) -> None:
        """The device: every period in, bytes out; what is not read for some periods is lost, as on a cable."""
        while (drive_v := self._periods.get()) is not None:
            wire = self.device.play(drive_v)
            while wire and self._periods.qsize() < HELD_PERIODS:
                if select.select([], [self._master], [], 0.01)[1]:
                    wire = wire[os.write(self._master, wire) :]

    def __enter__(self) -> Self:
        self._link.symlink_to(self.port)
        self._sender.start()
        self._client.activate()
        return self

    def __exit__(self, *exc: object) -> None:
        self._link.unlink(missing_ok=True)
        self._client.deactivate()
        self._client.close()
        for _ in range(HELD_PERIODS):
            self._periods.put(None)
        self._sender.join(5.0)
        os.close(self._master)
        os.close(self._slave)
