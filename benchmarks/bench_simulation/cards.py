"""A card behind its driver's callback, and a serial device behind its port, for the product's own back ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.bench_simulation.devices import SCALE, Ledger, Plate
from benchmarks.bench_simulation.plan import Fault, Plan
from benchmarks.bench_simulation.world import World
from daq.clocks.serial_frames import SerialFrame, encode_frame
from rig.backends.serial_daq import SerialReader, SoundcardSerialBackend
from rig.backends.soundcard import SoundcardBackend
from rig.profile import Profile

PERIOD = 128  # frames of a callback
ROWS = 64  # in a serial frame
RANGE_V = 10.0
START_S = 1.0  # until the ramp begins, about

Due = Sequence[tuple[int, Fault]]
"""Faults, each with the sample of the ramp at which it comes."""


class Card:
    """A card's stream: calls back each period; what it plays it hears one period later.

    Faults: ``short`` and ``declared`` skip whole periods, which the driver's count shows; ``late`` calls late, with a
    count that is a period ahead; ``stall`` calls none for a while, and loses none; ``gone`` ends.
    """

    def __init__(self, plan: Plan, world: World, ledger: Ledger, plate: Plate, faults: Due) -> None:
        self._world, self._ledger, self._plate = world, ledger, plate
        start = round(START_S * plan.rate_hz)
        self._faults = [(start + at, fault) for at, fault in sorted(faults, key=lambda due: due[0])]
        self._period_ns = PERIOD / plan.rate_hz * 1e9
        self._counter = plan.counter % 2**32
        self.active = False
        self.on_played: Callable[[int, np.ndarray], None] = lambda first, drive_v: None
        self._calls = 0
        self._out = np.zeros(PERIOD)

    def open(self, device: str, rate_hz: float, output: int, n_inputs: int, exchange: Any, woke: Any) -> Card:
        """As `rig.backends.portaudio.open_stream`."""
        self.active, self._n_inputs, self._exchange, self._woke = True, n_inputs, exchange, woke
        self._began_ns = self._called_ns = self._world.now_ns
        self._at(1)
        return self

    def close(self, *, alive: bool) -> None:
        """Stop calling; a card that had stopped by itself holds its last value until now, and then plays nothing."""
        self.active = False
        if self._world.now_ns - self._called_ns > 2.0 * self._period_ns:
            self._play(np.zeros(PERIOD))

    def _at(self, periods: int) -> None:
        self._calls += periods
        self._world.at(self._began_ns + round(self._calls * self._period_ns), self._call)

    def _call(self) -> None:
        """One period: the plate follows what was played, and the host is called."""
        if not self.active:
            return
        first, self._called_ns = self._ledger.n_out, self._world.now_ns
        due = [fault for at, fault in self._faults if at < first + PERIOD]
        self._faults = self._faults[len(due) :]
        kinds = {fault.kind: fault.n for fault in due}
        if "gone" in kinds:
            self.active = False
            return
        self._play(self._out)
        skipped = max(kinds.get("short", 0), kinds.get("declared", 0)) % 4096 // PERIOD
        for _ in range(skipped):
            self._play(np.zeros(PERIOD))
        codes = self._plate.codes(first, self._ledger.out[-1 - skipped]) if self._n_inputs else None
        ahead = PERIOD if "late" in kinds else 0
        out = np.zeros(PERIOD, np.float32)
        if codes is not None and not skipped:
            self._ledger.hand_over(codes, first + np.arange(PERIOD))
        if not skipped:
            heard = None if codes is None else (codes / 32768.0).astype(np.float32)
            self._exchange(heard, out, (self._counter + first + ahead) % 2**32)
            self._woke(0)
        self._out = out * RANGE_V
        self._at(1 + skipped + (kinds.get("stall", 0) * 2_000_000 // round(self._period_ns) if "stall" in kinds else 0))

    def _play(self, drive_v: np.ndarray) -> None:
        first = self._ledger.n_out
        self._ledger.play(drive_v)
        self.on_played(first, np.asarray(drive_v, np.float64))


class SerialDevice:
    """A converter with a quartz of its own that hears the drive, and the port that its frames come out of.

    Faults: ``short`` loses bytes, ``declared`` drops conversions and says so, ``doubled`` sends a frame twice,
    ``silent`` changes a byte, ``gone`` and ``stall`` as they say, ``jump`` sends what is no frame.
    """

    def __init__(self, plan: Plan, world: World, ledger: Ledger, plate: Plate, faults: Due) -> None:
        self._world, self._ledger, self._plate = world, ledger, plate
        start = round(START_S * plan.rate_hz)
        self._faults = [(start + at, fault) for at, fault in sorted(faults, key=lambda due: due[0])]
        self._period_ns = round(PERIOD / plan.rate_hz * 1e9)
        self.card_plays: Callable[[], bool] = lambda: False
        self._step = 1.0 + plan.drift  # drive samples a conversion
        self._first = plan.counter
        self._converted, self._sequence, self._overruns = 0, 2**32 - 100, 2**32 - 3
        self._drive, self._drive_at = np.zeros(1), -1
        self._wire, self._rows = bytearray(), np.zeros((0, 4), np.int16)
        self._gone = False
        self._silent_ns = 0

    def hear(self, first: int, drive_v: np.ndarray) -> None:
        """Convert what is played, and send whole frames."""
        self._drive = np.concatenate([self._drive, drive_v])
        last = self._drive_at + len(self._drive) - 1
        n = int((last - self._converted * self._step) // self._step)
        if n <= 0:
            return
        place = (self._converted + np.arange(n)) * self._step - self._drive_at
        volts = np.interp(place, np.arange(len(self._drive)), self._drive)
        codes = self._plate.codes(self._converted, volts)
        self._converted += n
        keep = max(int(place[-1]) - 1, 0)
        self._drive, self._drive_at = self._drive[keep:], self._drive_at + keep
        self._rows = np.concatenate([self._rows, codes])
        while len(self._rows) >= ROWS:
            self._send()

    def _send(self) -> None:
        n = self._converted - len(self._rows)  # of the first row
        due = [fault for at, fault in self._faults if at < n + ROWS]
        self._faults = self._faults[len(due) :]
        kinds = {fault.kind: fault.n for fault in due}
        rows, self._rows = self._rows[:ROWS], self._rows[ROWS:]
        self._gone |= "gone" in kinds
        if "gone" in kinds:
            self._ledger.causes.append(("serial gone", self._ledger.n_out))
        if "stall" in kinds:
            self._silent_ns = self._world.now_ns + kinds["stall"] * 2_000_000
        if "declared" in kinds:
            lost = min(kinds["declared"], ROWS - 1)
            self._overruns, rows, n = self._overruns + lost, rows[lost:], n + lost
        frame = SerialFrame(self._sequence % 2**32, self._first + n, self._overruns % 2**32, rows)
        self._sequence += 1
        wire = bytearray(encode_frame(frame))
        arrives = True
        if "short" in kinds:
            del wire[: min(kinds["short"], len(wire) - 1)]
            arrives = False
        if "silent" in kinds:
            wire[kinds["silent"] % (len(wire) - 1)] ^= 1 + kinds["silent"] % 254
            arrives = False
        if arrives:
            self._ledger.hand_over(rows, n + np.arange(len(rows)))
        self._wire += wire * (2 if "doubled" in kinds else 1)
        if "jump" in kinds:
            self._wire += bytes((np.arange(kinds["jump"]) * 7 % 256).astype(np.uint8)) + b"\0"

    # the port
    @property
    def in_waiting(self) -> int:
        """Bytes that can be read."""
        return 0 if self._world.now_ns < self._silent_ns else len(self._wire)

    def read(self, size: int) -> bytes:
        """Up to ``size`` of them."""
        if self._gone:
            raise OSError(5, "Input/output error")
        data = bytes(self._wire[: min(size, self.in_waiting)])
        del self._wire[: len(data)]
        return data

    def reset_input_buffer(self) -> None:
        """Forget what came; the device goes on sending."""
        self._wire.clear()
        self._idle()

    def _idle(self) -> None:
        """Convert while nothing is played."""
        if not self.card_plays():
            self.hear(0, np.zeros(PERIOD))
            self._world.at(self._world.now_ns + self._period_ns, self._idle)

    def close(self) -> None:
        """Let it go."""


def make_card(plan: Plan, profile: Profile, world: World, ledger: Ledger, plate: Plate, faults: Due) -> tuple[Any, int]:
    """The product's back end on simulated hardware, and the samples between handing over and playing, at most."""
    is_serial = plan.device == "serial"
    card = Card(plan, world, ledger, plate, [] if is_serial else faults)
    # handed over ahead, the period being played and the one before, and the fade of a card that is let go
    behind = round(0.05 * plan.rate_hz) + 3 * PERIOD + round(0.3 * plan.rate_hz)
    if not is_serial:
        return SoundcardBackend(profile, opener=card.open, clock=world), behind
    device = SerialDevice(plan, world, ledger, plate, faults)
    card.on_played, device.card_plays = device.hear, lambda: card.active
    reader = SerialReader("simulation", 4, plan.rate_hz, lambda: device, world)
    ranges_v = dict.fromkeys(("continuity", "accelerometer", "drive", "displacement"), SCALE * 32768.0)
    backend = SoundcardBackend(profile, play_only=True, opener=card.open, clock=world)
    frequency_hz = profile.forcing.frequency_hz
    return SoundcardSerialBackend(backend, reader, ranges_v, profile.backend.marker_v, frequency_hz), behind
