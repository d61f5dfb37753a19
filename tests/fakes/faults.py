"""Faults of devices, as a layer between a back end and its user.

A fault changes the device's frames, readings or drive and nothing else. Whether a driver
reports a loss is part of the fault. Sample indices of faults are the device's own, lost frames counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import Block, BlockFlag
from kernels.arrays import Floats
from rig.backends.base import Backend, BackendError, checked_drive

Codes = NDArray[np.int16]


@dataclass(frozen=True)
class Device:
    """What a fault may know of the device it sits in.

    Attributes
    ----------
    rate_hz : float
    columns : mapping of channel name to column
    volts_per_code : mapping of channel name to scale
    """

    rate_hz: float
    columns: Mapping[str, int]
    volts_per_code: Mapping[str, float]


class Fault:
    """A device without fault; each fault overrides what it spoils."""

    def reset(self, device: Device) -> None:
        """Begin a run: forget everything and learn the device."""

    def on_drive(self, first: int, drive_v: Floats) -> Floats:
        """What reaches the plate of ``drive_v``, samples from ``first`` on; raises `BackendError` if nothing can."""
        return drive_v

    def on_block(self, first: int, block: Block) -> Block:
        """What the host gets of ``block``, whose frames are the device's samples from ``first`` on."""
        return block


@dataclass
class ClockError(Fault):
    """Clock readings of a host clock that is off: ``(1 + drift)`` host seconds a device second, offset and jitter.

    Replaces the block's reading, so that clock checks can be tried at any simulation speed.
    """

    offset_ns: int = 0
    drift: float = 0.0
    jitter_ns: float = 0.0
    rng: np.random.Generator | None = None
    _rate_hz: float = field(default=1.0, init=False)

    def reset(self, device: Device) -> None:
        self._rate_hz = device.rate_hz

    def on_block(self, first: int, block: Block) -> Block:
        end_s = (first + len(block.codes)) / self._rate_hz
        late_ns = abs(self.jitter_ns * self.rng.standard_normal()) if self.rng is not None else 0.0
        return replace(block, clock_ns=self.offset_ns + round(end_s * (1.0 + self.drift) * 1e9 + late_ns))


@dataclass
class LostFrames(Fault):
    """``n_samples`` frames are lost at the first block boundary at or after ``at_sample``; the drive plays on.

    Blocks that fall into the loss come short, or empty. ``declared`` says whether the driver reports the count with
    the next block; if not, ``flagged`` says whether it sets its overflow flag.
    """

    at_sample: int
    n_samples: int
    declared: bool = False
    flagged: bool = False
    _left: int = field(default=-1, init=False)

    def reset(self, device: Device) -> None:
        self._left = -1

    def on_block(self, first: int, block: Block) -> Block:
        if self._left < 0 and first >= self.at_sample:
            self._left = self.n_samples
        if self._left <= 0:
            return block
        lost = min(self._left, len(block.codes))
        self._left -= lost
        block = replace(block, codes=block.codes[lost:])
        if self._left > 0:
            return block
        flags = block.flags | (BlockFlag.OVERFLOW if self.declared or self.flagged else 0)
        known = self.n_samples if self.declared else 0
        return replace(block, flags=int(flags), lost_before=block.lost_before + known)


@dataclass
class RepeatedBlock(Fault):
    """One block is handed over again in the place of the next one."""

    at_sample: int
    _last: Codes | None = field(default=None, init=False)
    _done: bool = field(default=False, init=False)

    def reset(self, device: Device) -> None:
        self._last, self._done = None, False

    def on_block(self, first: int, block: Block) -> Block:
        last, self._last = self._last, block.codes
        if self._done or first < self.at_sample or last is None or len(last) != len(block.codes):
            return block
        self._done = True
        return replace(block, codes=last.copy())


@dataclass
class AcCoupling(Fault):
    """A channel's input is capacitor-coupled: a first-order high-pass."""

    channel: str
    corner_hz: float
    _column: int = field(default=0, init=False)
    _keep: float = field(default=1.0, init=False)
    _mean: float | None = field(default=None, init=False)

    def reset(self, device: Device) -> None:
        self._column, self._mean = device.columns[self.channel], None
        self._keep = math.exp(-2.0 * math.pi * self.corner_hz / device.rate_hz)

    def on_block(self, first: int, block: Block) -> Block:
        from scipy.signal import lfilter  # imported late: rigs without this fault need no SciPy

        x = block.codes[:, self._column].astype(np.float64)
        if not x.size:
            return block
        start = x[0] if self._mean is None else self._mean
        mean, _ = lfilter([1.0 - self._keep], [1.0, -self._keep], x, zi=[self._keep * start])
        self._mean = float(mean[-1])
        return _with_column(block, self._column, np.rint(x - mean))


@dataclass
class Clipping(Fault):
    """A channel's input stage clips at ``limit_v``, below the converter's range."""

    channel: str
    limit_v: float
    _column: int = field(default=0, init=False)
    _limit: float = field(default=0.0, init=False)

    def reset(self, device: Device) -> None:
        self._column, self._limit = device.columns[self.channel], self.limit_v / device.volts_per_code[self.channel]

    def on_block(self, first: int, block: Block) -> Block:
        return _with_column(block, self._column, np.clip(block.codes[:, self._column], -self._limit, self._limit))


@dataclass
class JammedSensor(Fault):
    """From ``from_sample`` on a channel repeats its last value."""

    channel: str
    from_sample: int
    _column: int = field(default=0, init=False)
    _held: float = field(default=0.0, init=False)

    def reset(self, device: Device) -> None:
        self._column, self._held = device.columns[self.channel], 0.0

    def on_block(self, first: int, block: Block) -> Block:
        x = block.codes[:, self._column].astype(np.float64)
        alive = min(max(self.from_sample - first, 0), x.size)
        self._held = float(x[alive - 1]) if alive else self._held
        x[alive:] = self._held
        return _with_column(block, self._column, x)


@dataclass
class LooseCable(Fault):
    """Between two samples a channel's cable makes contact only now and then; apart, it reads ``apart_v`` and noise.

    A wire of the continuity circuit that comes off reads 5 V, as an open contact does.
    """

    channel: str
    from_sample: int
    to_sample: int
    rng: np.random.Generator
    apart_v: float = 0.0
    noise_v: float = 0.02
    mean_samples: float = 200.0
    _column: int = field(default=0, init=False)
    _scale_v: float = field(default=1.0, init=False)
    _apart: bool = field(default=False, init=False)
    _until: int = field(default=0, init=False)

    def reset(self, device: Device) -> None:
        self._column, self._scale_v = device.columns[self.channel], device.volts_per_code[self.channel]
        self._apart, self._until = False, self.from_sample

    def on_block(self, first: int, block: Block) -> Block:
        x = block.codes[:, self._column].astype(np.float64)
        end = min(first + x.size, self.to_sample)
        at = max(first, self.from_sample)
        while at < end:
            if at >= self._until:
                self._apart = not self._apart
                self._until = at + 1 + int(self.rng.exponential(self.mean_samples))
            stop = min(self._until, end)
            if self._apart:
                noise = self.noise_v * self.rng.standard_normal(stop - at)
                x[at - first : stop - first] = (self.apart_v + noise) / self._scale_v
            at = stop
        return _with_column(block, self._column, np.rint(x))


@dataclass
class Unplugged(Fault):
    """The card goes away at a sample: the exchange that reaches it fails, and so does each one after."""

    at_sample: int

    def on_drive(self, first: int, drive_v: Floats) -> Floats:
        if first + drive_v.size > self.at_sample:
            raise BackendError("the device went away (unplugged?): check its cable, then start again")
        return drive_v


@dataclass
class AmplifierTrip(Fault):
    """The amplifier's protection opens at a sample: the plate gets nothing, the looped-back drive goes on."""

    at_sample: int
    _column: int = field(default=0, init=False)
    _scale_v: float = field(default=1.0, init=False)
    _asked: Floats = field(default_factory=lambda: np.zeros(0), init=False)

    def reset(self, device: Device) -> None:
        self._column, self._scale_v = device.columns["drive"], device.volts_per_code["drive"]

    def on_drive(self, first: int, drive_v: Floats) -> Floats:
        self._asked = drive_v
        return np.where(first + np.arange(drive_v.size) < self.at_sample, drive_v, 0.0)

    def on_block(self, first: int, block: Block) -> Block:
        asked = np.rint(self._asked[: len(block.codes)] / self._scale_v)
        tripped = first + np.arange(len(block.codes)) >= self.at_sample
        return _with_column(block, self._column, np.where(tripped, asked, block.codes[:, self._column]))


def _with_column(block: Block, column: int, values: Floats) -> Block:
    """The block with one column replaced, kept within 16 bits."""
    codes = block.codes.copy()
    codes[:, column] = np.clip(values, -32768, 32767).astype(np.int16)
    return replace(block, codes=codes)


class FaultyBackend:
    """A back end seen through faults; itself a back end.

    Parameters
    ----------
    inner : Backend
        The device.
    faults : sequence of Fault
        Applied in this order, device side first; losses belong last but for clock errors.
    """

    def __init__(self, inner: Backend, faults: Sequence[Fault]) -> None:
        self._inner, self._faults = inner, tuple(faults)
        self.name, self.simulated = inner.name, inner.simulated
        self.channels, self.scales, self.rate_hz = inner.channels, inner.scales, inner.rate_hz
        self.scenario_sha256 = inner.scenario_sha256
        self._device_sample = self._recorded = 0

    def start(self) -> None:
        """Start the device and begin all faults anew."""
        self._inner.start()
        columns = {name: place for place, name in enumerate(self.channels)}
        device = Device(self.rate_hz, columns, {name: self.scales[name][0] for name in self.channels})
        for fault in self._faults:
            fault.reset(device)
        self._device_sample = self._recorded = 0

    def exchange(self, drive_v: Floats) -> Block:
        """Play ``drive_v`` (n,); returns at most n frames, numbered as recorded. Raises `BackendError`."""
        drive = checked_drive(drive_v)
        first = self._device_sample
        for fault in self._faults:
            drive = fault.on_drive(first, drive)
        block = self._inner.exchange(drive)
        for fault in self._faults:
            block = fault.on_block(first, block)
        self._device_sample += drive.size
        block = replace(block, first_sample=self._recorded)
        self._recorded += len(block.codes)
        return block

    def stop(self) -> None:
        """Stop the device."""
        self._inner.stop()
