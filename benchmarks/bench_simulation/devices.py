"""The bench's hardware as the product meets it: plate and ball, a plain device, a card's driver, a serial port.

Each records what it really did: every drive sample that reached the plate, every frame that it handed over, with its
own number. The fourth channel of a frame spells its number, so that a frame cannot pass for another.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from benchmarks.bench_simulation.plan import SENSOR, Fault
from benchmarks.bench_simulation.world import World
from daq.files.tables import Block, BlockFlag, volts_per_code
from rig.backends.base import BackendError

CHANNELS = ("continuity", "accelerometer", "drive", "displacement")
SCALE = volts_per_code(10.0)
G_PER_VOLT = 2.0
NOISE_V = 2e-4
N_NOISE, N_SPELLED = 1 << 17, 1 << 20  # after which noise and spelled numbers come again


@functools.cache
def _spelled() -> np.ndarray:
    """Codes that follow from the numbers of frames."""
    numbers = np.arange(N_SPELLED, dtype=np.uint64)
    return ((numbers * np.uint64(2654435761)) >> np.uint64(9)).astype(np.uint16).view(np.int16)


@functools.cache
def _noise_v() -> np.ndarray:
    """Noise of three inputs; drawing it anew for each run takes as long as a tenth of the run."""
    return NOISE_V * np.random.default_rng(0).standard_normal((N_NOISE, 3))


@dataclass
class Ledger:
    """What the hardware really did."""

    rate_hz: float
    out: list[np.ndarray] = field(default_factory=list)  # drive samples that reached the plate, from number 0 on
    n_out: int = 0
    codes: list[np.ndarray] = field(default_factory=list)  # frames handed over
    numbers: list[np.ndarray] = field(default_factory=list)  # and their numbers
    causes: list[tuple[str, int]] = field(default_factory=list)  # why the drive must end, and the sample at that time

    def play(self, drive_v: np.ndarray) -> None:
        """Drive samples that reach the plate now."""
        self.out.append(np.array(drive_v, np.float64))
        self.n_out += len(drive_v)

    def hand_over(self, codes: np.ndarray, numbers: np.ndarray) -> None:
        """Frames that the host gets."""
        self.codes.append(codes)
        self.numbers.append(numbers)


class Plate:
    """Plate, ball, contact and accelerometer, by the drive; sensors fail as they are asked to."""

    def __init__(self, plan_faults: Iterable[Fault], n_planned: int, rng: np.random.Generator) -> None:
        self._at = {fault.kind: fault.at * n_planned for fault in plan_faults if fault.kind in SENSOR}
        self._noise_from = int(rng.integers(N_NOISE))
        self._held = 0

    def codes(self, first: int, drive_v: np.ndarray) -> np.ndarray:
        """Frames ``(n, 4)`` of samples from ``first`` on."""
        n = len(drive_v)
        volts, codes = np.empty((n, 3)), np.empty((n, 4), np.int16)
        # many small calls: as little as can be is done while no sensor fails
        since = {kind: np.arange(first, first + n) >= at for kind, at in self._at.items() if first + n > at}
        loop_v = np.where(since["muted"], 0.0, drive_v) if "muted" in since else drive_v
        moved_g = G_PER_VOLT * loop_v
        if "weak" in since:
            moved_g = np.where(since["weak"], 0.3 * moved_g, moved_g)
        is_open = moved_g < -1.0
        if since:
            is_open = is_open & ~since.get("closed", np.False_) | since.get("open", np.False_)
        volts[:, 0], volts[:, 1], volts[:, 2] = 5.0 * is_open, 0.1 * moved_g, loop_v
        if "dead" in since:
            volts[since["dead"], 1] = 0.0
        if "clipped" in since:
            volts[since["clipped"], 1] = volts[since["clipped"], 1].clip(-0.02, 0.02)
        volts += _noise_v().take(np.arange(first, first + n) + self._noise_from, axis=0, mode="wrap")
        np.rint(volts / SCALE, out=volts)
        codes[:, :3] = np.maximum(np.minimum(volts, 32767.0), -32768.0)
        if "stuck" in since:
            stuck = since["stuck"]
            if not stuck[0]:
                self._held = int(codes[~stuck][-1, 1])
            codes[stuck, 1] = self._held
        codes[:, 3] = _spelled().take(np.arange(first, first + n), mode="wrap")
        return codes


class PlainDevice:
    """A device that plays and records a block at a call, as a DAQ card's library does (`rig.backends.base.Backend`)."""

    scenario_sha256: str | None = None
    channels = CHANNELS

    def __init__(
        self, world: World, ledger: Ledger, plate: Plate, faults: Iterable[tuple[int, Fault]], *, simulated: bool
    ) -> None:
        self.name, self.simulated, self.rate_hz = "simulation", simulated, ledger.rate_hz
        self.scales: Mapping[str, tuple[float, float]] = dict.fromkeys(CHANNELS, (SCALE, 0.0))
        self._world, self._ledger, self._plate = world, ledger, plate
        self._faults = sorted(faults, key=lambda due: due[0])
        self._n = self._given = 0
        self._gone = False
        self._last: np.ndarray = np.zeros((0, 4), np.int16)
        self._numbers: np.ndarray = np.zeros(0, np.int64)

    def start(self) -> None:
        """Ready."""
        self._n = self._given = self._ledger.n_out = 0

    def stop(self) -> None:
        """The device plays zeros."""

    def exchange(self, drive_v: np.ndarray) -> Block:
        """Play, and hand over what was recorded meanwhile, with what goes wrong in it."""
        if self._gone:
            raise BackendError("the device is gone")
        n, first = len(drive_v), self._n
        due = [fault for at, fault in self._faults if at < first + n]
        self._faults = self._faults[len(due) :]
        kinds = {fault.kind: fault.n for fault in due}
        if "gone" in kinds:
            self._gone = True
            self._ledger.causes.append(("gone", first))
            raise BackendError("the device went away")
        self._ledger.play(drive_v)
        if kinds.get("stall", 0) >= 300 and not self.simulated:
            self._ledger.causes.append(("silence of the device", first + n))
        wait_ns = round(n / self.rate_hz * 1e9)
        wait_ns += 1_000_000 * (kinds.get("late", 0) % 400 + kinds.get("stall", 0) * 2)
        self._world.advance(wait_ns)
        codes, numbers = self._plate.codes(first, drive_v), first + np.arange(n)
        self._n += n
        lost = min(kinds.get("short", kinds.get("declared", 0)), n)
        said = lost if "declared" in kinds else 0
        if lost:
            codes, numbers = codes[lost:], numbers[lost:]
        if "doubled" in kinds and len(self._last) == len(codes):
            codes, numbers = self._last, self._numbers
        self._last, self._numbers = codes, numbers
        self._ledger.hand_over(codes, numbers)
        block = Block(
            self._given,
            codes.copy(),
            flags=int(BlockFlag.OVERFLOW) if lost else 0,
            clock_ns=self._world.monotonic_ns(),
            lost_before=said,
        )
        self._given += len(codes)
        return block
