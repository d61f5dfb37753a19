"""A simulated rig that samples by a clock of its own and sends serial frames, as a microcontroller would.

It knows the drive as a voltage in time and nothing else. What it converts at its own instants lies
between the samples that were played; a cubic through the four around an instant gives it to a few parts in a million.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from daq.clocks.serial_frames import SerialFrame, encode_frame
from kernels.arrays import Floats
from rig.sim.plant import REFRESH_SAMPLES, Plant
from rig.sim.scenario import Scenario

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
