"""The plant behind two drivers: the drive comes by JACK, frames leave by a pseudo-terminal, on a clock of their own.

The simulated device samples by its own clock and sends serial frames, as a microcontroller would. It knows the drive as
a voltage in time and nothing else. What it converts at its own instants lies between the samples that were played; a
cubic through the four around an instant gives it to a few parts in a million. POSIX only has pseudo-terminals:
elsewhere this is refused.
"""

from __future__ import annotations

import os
import queue
import select
import threading
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from daq.clocks.serial_frames import SerialFrame, encode_frame
from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.kinds.soundcard_serial import SoundcardSerialOptions
from rig.profile import Profile
from rig.sim.plant import REFRESH_SAMPLES, Plant
from rig.sim.scenario import Scenario
from rig.virtual.jack import PlantClient

ROWS = 64  # in a frame


class SerialDevice:
    """A plant behind a converter with a quartz of its own.

    Parameters
    ----------
    scenario
        What the rig hides; its clock error is replaced by the one given here.
    rate_hz
        Nominal rate of the device and of the drive.
    rng
        As for `rig.sim.plant.Plant`.
    ppm, ppm_per_minute
        By how much an interval of the device is too long at the start, and what that gains.
    further
        As for `rig.sim.plant.Plant`.
    """

    def __init__(
        self,
        scenario: Scenario,
        rate_hz: float,
        rng: np.random.Generator,
        *,
        ppm: float = 0.0,
        ppm_per_minute: float = 0.0,
        further: Collection[str] = (),
    ) -> None:
        drift = dict(scenario.drift_per_minute)
        if ppm_per_minute:
            drift["clock_error.relative"] = ppm_per_minute * 1e-6
        effects = dict(scenario.effects) | {"clock_error": {"relative": ppm * 1e-6}}
        scenario = replace(scenario, effects=effects, drift_per_minute=drift)
        self.plant = Plant(scenario, rate_hz, rng, further=further)
        self._ppm, self._ppm_per_s = ppm, ppm_per_minute / 60.0
        self._rate_hz = rate_hz
        self._drive = np.zeros(2)  # from two samples before the first
        self._first = -2
        self._time_s = 0.0
        self._codes = np.zeros((0, len(self.plant.channels)), np.int16)
        self._sent = self._sequence = 0

    def play(self, drive_v: Floats) -> bytes:
        """Take in drive samples; gives back the bytes that the device sends meanwhile."""
        self._drive = np.concatenate([self._drive, drive_v])
        while self._convert():
            pass
        wire = b""
        while len(self._codes) >= ROWS:
            frame = SerialFrame(self._sequence, self._sent, 0, self._codes[:ROWS])
            wire += encode_frame(frame)
            self._codes = self._codes[ROWS:]
            self._sent, self._sequence = self._sent + ROWS, (self._sequence + 1) % 2**32
        return wire

    def _convert(self) -> bool:
        """The next conversions, as many as the plant takes with one clock error; False when the drive ends first."""
        interval_s = (1.0 + 1e-6 * (self._ppm + self._ppm_per_s * self._time_s)) / self._rate_hz
        step: Floats = np.arange(REFRESH_SAMPLES, dtype=np.float64)
        place: Floats = (self._time_s + interval_s * step) * self._rate_hz - self._first
        if int(place[-1]) + 2 >= len(self._drive):
            return False
        self._codes = np.concatenate([self._codes, self.plant.exchange(_between(self._drive, place))])
        self._time_s += interval_s * REFRESH_SAMPLES
        done = int(place[-1]) - 2
        self._drive, self._first = self._drive[done:], self._first + done
        return True


def _between(samples: Floats, place: Floats) -> Floats:
    """Values at places between samples: the cubic through the four nearest (Lagrange)."""
    k = place.astype(np.int64)
    u = place - k
    before, here, after, beyond = (samples[k + i] for i in (-1, 0, 1, 2))
    return np.asarray(
        -u * (u - 1.0) * (u - 2.0) / 6.0 * before
        + (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0 * here
        - (u + 1.0) * u * (u - 2.0) / 2.0 * after
        + (u + 1.0) * u * (u - 1.0) / 6.0 * beyond
    )


HELD_PERIODS = 4  # of frames that the device holds for a reader that is late


class JackSerialPlant(PlantClient):
    """A plant that hears the client ``profile.backend.device`` and sends its frames to a pseudo-terminal.

    Raises `InputError` when there is no such server, it runs at another rate, or the system has no pseudo-terminals.

    Arguments are as of `rig.virtual.jack.JackPlant` and `rig.virtual.serial.SerialDevice`.

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
