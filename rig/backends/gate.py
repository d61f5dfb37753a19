"""A gate on a microcontroller in the drive's way: heartbeats keep it open, and it closes itself when they end.

`firmware/shaker_gate.c` is its other end; the messages are in docs/reference/serial-frame.md. Each exchange with the
device answers the newest count that came from the gate, so whatever stops the exchanges closes the gate: a kill of the
process, a system that hangs, a cable that is pulled. A person opens it again by its button.
"""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from daq.clocks.serial_frames import packed, unpacked
from daq.files.tables import Block
from daq.setup.clock import SYSTEM, Clock
from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.base import Backend, BackendError, Port, open_port
from rig.backends.kinds.soundcard import CardOptions
from rig.profile import Profile

VERSION = 1
ARM, BEAT, END, STATUS = 1, 2, 3, 128
REST, OPEN, FADING, LATCHED = range(4)
CAUSES = ("asked to", "heartbeats ended", "the drive was beyond its limit", "the drive changed faster than its limit")
FULL_SCALE = 32767
FIRST_S = 2.0  # until the gate's first message
SILENCE_S = 0.5  # without a message from the gate
LONGEST_BLOCK = 2.0 / 3.0  # of a cycle: between two heartbeats
_STATUS = struct.Struct("<BBIBB")


@dataclass(frozen=True)
class GateLimits:
    """What the gate holds the drive to: samples of its own clock in a cycle of the forcing, codes, codes a sample."""

    cycle: int
    limit: int
    slew: int


@dataclass(frozen=True)
class GateStatus:
    """One message of the gate: its count of samples, its state, and why it closed."""

    now: int
    state: int
    cause: int


def gated(backend: Backend, profile: Profile, table: CardOptions) -> Backend:
    """``backend`` behind the gate of a profile; the back end itself where the profile has none.

    Raises `InputError` when blocks are so long that two heartbeats would come too late.
    """
    if not table.gate_port:
        return backend
    cycle_s, block_s = 1.0 / profile.forcing.frequency_hz, table.block_samples / profile.sampling.rate_hz
    if block_s > LONGEST_BLOCK * cycle_s:
        most = int(LONGEST_BLOCK * cycle_s * profile.sampling.rate_hz)
        raise InputError(
            f"profile {profile.name!r}: backend.block_samples = {table.block_samples} leaves {1e3 * block_s:.0f} ms "
            f"between heartbeats of the gate, a cycle has {1e3 * cycle_s:.0f} ms; wanted {most} at most"
        )
    highest_hz = profile.forcing.frequency_hz * profile.forcing.multiples[-1]
    limits = limits_for(profile.forcing.frequency_hz, highest_hz, table.gate_limit, table.gate_rate_hz)

    def opener() -> Port:
        return open_port(table.gate_port, 115200, 0.0, whose="gate", key="backend.gate_port")

    return GatedBackend(backend, opener, limits)


def limits_for(frequency_hz: float, highest_hz: float, part: float, rate_hz: float) -> GateLimits:
    """Limits for a drive of tones up to ``highest_hz`` of at most ``part`` of full scale, at the gate's ``rate_hz``.

    The slew is one and a half times that of the highest tone by itself at the largest amplitude.
    """
    limit = round(part * FULL_SCALE)
    slew = 1.5 * 2.0 * math.pi * highest_hz / rate_hz * limit
    return GateLimits(round(rate_hz / frequency_hz), limit, max(1, min(FULL_SCALE, round(slew))))


def message(kind: int, seen: int, limits: GateLimits | None = None) -> bytes:
    """A message to the gate, answering its count ``seen``."""
    packet = struct.pack("<BBI", VERSION, kind, seen % 2**32)
    if limits is not None:
        packet += struct.pack("<HHH", limits.cycle, limits.limit, limits.slew)
    return packed(packet)


class StatusReader:
    """Bytes, however cut, to the newest message that is in them."""

    def __init__(self) -> None:
        self._held = b""

    def feed(self, data: bytes) -> GateStatus | None:
        """Take in bytes; gives back the last whole message that ended in them."""
        *ended, self._held = (self._held + data).split(b"\0")
        self._held = self._held[-64:]
        for wire in reversed(ended):
            body = unpacked(wire)
            if body is None or len(body) != _STATUS.size:
                continue
            version, kind, now, state, cause = _STATUS.unpack(body)
            if (version, kind) == (VERSION, STATUS) and state <= LATCHED and cause < len(CAUSES):
                return GateStatus(now, state, cause)
        return None


class GatedBackend:
    """A back end ``inner`` whose drive passes through a gate; everything but the heartbeats is the back end's.

    Its looped-back drive is taken before the gate. ``opener`` opens the gate's port, whose reads do not wait; the gate
    is armed with ``limits``. A simulation has a ``clock`` of its own.
    """

    def __init__(self, inner: Backend, opener: Callable[[], Port], limits: GateLimits, clock: Clock = SYSTEM) -> None:
        self._inner, self._opener, self._limits, self._clock = inner, opener, limits, clock
        self._port: Port | None = None
        self._reader = StatusReader()
        self._status: GateStatus | None = None
        self._heard_s = 0.0
        self._armed = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def start(self) -> None:
        """Open the gate's port, hear from it, and start the back end; raises `BackendError`."""
        self.stop()
        self._port, self._reader, self._status, self._armed = self._opener(), StatusReader(), None, False
        ends = self._clock.monotonic_s() + FIRST_S
        try:
            while self._status is None:
                self._listen()
                if self._clock.monotonic_s() > ends:
                    why = "is it powered, and is backend.gate_port its port?"
                    raise BackendError(f"gate: silent for {FIRST_S:g} s; {why}")
                self._clock.sleep(0.005)
            self._refuse_closed()
            self._inner.start()
        except BackendError:
            self.stop()
            raise

    def exchange(self, drive_v: Floats) -> Block:
        """As of the back end, once the gate has been answered; raises `BackendError` where it has closed itself."""
        if self._port is None:
            raise BackendError("not started")
        self._listen()
        self._refuse_closed()
        if self._clock.monotonic_s() - self._heard_s > SILENCE_S:
            raise BackendError(f"gate: no message for {SILENCE_S:g} s; it closes by itself: check its cable")
        status = self._status
        if status is not None:
            first = not self._armed or status.state == REST
            beat = message(ARM if first else BEAT, status.now, self._limits if first else None)
            try:
                self._port.write(beat)
            except OSError as error:
                raise self._went_away(error) from error
            self._armed = True
        return self._inner.exchange(drive_v)

    def stop(self) -> None:
        """Let the gate close without a latch, then stop the back end; may be called at any time."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):  # without a message it closes, too
                try:
                    if self._status is not None:
                        port.write(message(END, self._status.now))
                finally:
                    port.close()
        self._inner.stop()

    def _listen(self) -> None:
        """Take in what the gate has sent."""
        port = self._port
        if port is None:
            return
        try:
            status = self._reader.feed(port.read(max(1, port.in_waiting)))
        except OSError as error:
            raise self._went_away(error) from error
        if status is not None:
            self._status, self._heard_s = status, self._clock.monotonic_s()

    @staticmethod
    def _went_away(error: OSError) -> BackendError:
        return BackendError(f"gate: went away ({error}); it closes by itself: check its cable")

    def _refuse_closed(self) -> None:
        status = self._status
        if status is not None and (status.state == LATCHED or (status.state == FADING and status.cause)):
            raise BackendError(f"gate: has closed itself ({CAUSES[status.cause]}); press its button, then start again")
