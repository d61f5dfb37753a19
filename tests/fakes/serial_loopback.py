"""A simulated serial device on the bench: a card that plays into it, and a port that its bytes come out of.

The only way from the drive to the samples is through the device, on its own clock.
"""

from __future__ import annotations

import threading

import numpy as np

from daq.files.tables import Block, volts_per_code
from kernels.arrays import Floats
from rig.backends.base import BackendError, checked_drive
from rig.virtual import SerialDevice

WAIT_S = 0.05  # for bytes that do not come


class WiredPort:
    """The port of a simulated device, as `serial.Serial` is used by `rig.backends.serial_daq`.

    Parameters
    ----------
    device
        What sends.
    idle_samples
        For how long it has run undriven when somebody begins to listen.
    """

    def __init__(self, device: SerialDevice, idle_samples: int = 2000) -> None:
        self._device, self._idle_samples = device, idle_samples
        self._bytes = bytearray()
        self.played_samples = 0
        self._changed = threading.Condition()
        self._gone = False

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return len(self._bytes)

    def play(self, drive_v: Floats) -> None:
        """Drive the device; what it sends meanwhile can be read."""
        data = self._device.play(drive_v)
        with self._changed:
            self.played_samples += len(drive_v)
            self._bytes += data
            self._changed.notify_all()

    def unplug(self) -> None:
        """From now on reading fails."""
        with self._changed:
            self._gone = True
            self._changed.notify_all()

    def read(self, size: int) -> bytes:
        """Up to ``size`` bytes; fewer when the time is up."""
        with self._changed:
            self._changed.wait_for(lambda: self._gone or len(self._bytes) >= size, WAIT_S)
            if self._gone:
                raise OSError("device unplugged")
            data = bytes(self._bytes[:size])
            del self._bytes[:size]
            return data

    def reset_input_buffer(self) -> None:
        """Forget what came before; the device goes on sending."""
        with self._changed:
            self._bytes.clear()
        self.play(np.zeros(self._idle_samples))

    def close(self) -> None:
        """Nothing to let go of."""


class WiredCard:
    """A card without inputs that plays into the device behind ``port``, at full speed."""

    name = "wired"
    simulated = True
    scenario_sha256: str | None = None
    channels = ("drive",)

    def __init__(self, port: WiredPort, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.scales = {"drive": (volts_per_code(10.0), 0.0)}
        self.last_v = 0.0
        self._n_samples = 0
        self._port = port
        self._running = False

    def start(self) -> None:
        """Ready to play; the device has been running all along."""
        self._running = True

    def exchange(self, drive_v: Floats) -> Block:
        """Play; frames of nothing come back."""
        drive = checked_drive(drive_v)
        if not self._running:
            raise BackendError("not started")
        first, self._n_samples = self._n_samples, self._n_samples + len(drive)
        if len(drive):
            self.last_v = float(drive[-1])
        self._port.play(drive)
        return Block(first, np.zeros((len(drive), 1), np.int16))

    def stop(self) -> None:
        """Leave the drive at 0 V."""
        self._running, self.last_v = False, 0.0
