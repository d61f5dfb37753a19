"""What must be so after every run, by what the hardware did: none of the product's accounts is believed.

The file is opened by the product, as a user would; what comes out is compared with the frames that were handed over.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_simulation.bench import Bench, Left
from benchmarks.bench_simulation.devices import CHANNELS
from benchmarks.bench_simulation.disk import Disk
from benchmarks.bench_simulation.plan import DEVICE, DISK, RECORDER, Plan
from benchmarks.bench_simulation.world import Stuck
from benchmarks.forked import in_copy
from benchmarks.read_here import read_here
from daq.files.tables import BlockFlag
from daq.recording import VerifyReport, open_recording, verify
from daq.recording.recover import recover
from daq.recording.verify import report_of
from daq.setup.errors import InputError

SPOILS_DISK = {*DISK, *RECORDER}
MISCOUNTS = {"silent", "doubled"}  # a driver that lies: the count is the product's estimate, with its uncertainty
MOVES_V = 0.3  # of drive: the plate moves well


def simulate(plan: Plan, disk: Disk) -> tuple[list[str], str, float]:
    """Run a plan: what was broken, a fingerprint of all that was played and left, and the seconds that it lived.

    A copy of this process runs it: what a killed recorder leaves in HDF5's memory crashes a later run.
    """
    answer = in_copy(lambda: simulate_here(plan, disk), patience_s=300.0)
    broken, print_, seconds = answer or (["the simulation crashed"], "", 0.0)
    return broken, print_, seconds


def simulate_here(plan: Plan, disk: Disk) -> tuple[list[str], str, float]:
    """The same in this process."""
    left = Bench(plan, disk).run()
    found = Judge(left, disk)
    found.drive()
    found.sensors()
    found.end()
    found.file()
    found.copies()
    found.flipped()
    return [*left.said, *found.broken], found.fingerprint(), left.seconds


class Judge:
    """The invariants of one run; ``broken`` has a line for each that does not hold."""

    def __init__(self, left: Left, disk: Disk) -> None:
        self._left, self._disk = left, disk
        self._kinds = {fault.kind for fault in left.plan.faults}
        self.broken: list[str] = []
        ledger = left.ledger
        self._codes = np.concatenate([np.zeros((0, 4), np.int16), *ledger.codes])
        self._numbers = np.concatenate([np.zeros(0, np.int64), *ledger.numbers])
        # a driver that lies is counted by the product's estimate; of the serial line only damage is meant by that
        self._lies = left.plan.device == "plain" and bool(self._kinds & MISCOUNTS)
        self._states: list[str] = []
        self._n_recovered = 0

    def _require(self, holds: Any, what: str) -> None:
        if not holds:
            self.broken.append(what)

    def drive(self) -> None:
        """Within limits at every sample; at zero within two cycles of any cause, and at the end."""
        left, ledger = self._left, self._left.ledger
        out = np.concatenate([np.zeros(0), *ledger.out])
        limit = left.plan.drive_limit_v
        over = np.flatnonzero(np.abs(out) > limit * (1.0 + 1e-6))
        self._require(not over.size, f"drive beyond its limit from sample {over[:1]}")
        cycle = left.plan.rate_hz / left.plan.frequency_hz
        for name, at in ledger.causes:
            late = out[at + int(np.ceil(2.0 * cycle)) + 1 + left.buffer_samples :]
            self._require(not late.any(), f"drive not at zero two cycles after {name} (sample {at})")
        if not left.was_killed and left.began and out.size and "gone" not in self._kinds:
            self._require(out[-1] == 0.0, f"drive ends at {out[-1]:.3g} V")

    def sensors(self) -> None:
        """A sensor that fails ends the drive within a dozen cycles in which the plate moves well."""
        plan = self._left.plan
        out, cycle = np.concatenate([np.zeros(0), *self._left.ledger.out]), round(plan.rate_hz / plan.frequency_hz)
        for fault in plan.faults:
            if fault.kind in ("stuck", "dead", "open") and plan.device == "plain":
                after = out[round(fault.at * self._left.n_planned) :]
                cycles = np.abs(after[: len(after) // cycle * cycle].reshape(-1, cycle)).max(axis=1) > MOVES_V
                moving = np.convolve(cycles, np.ones(12), "valid") if len(cycles) >= 12 else np.zeros(1)
                self._require(moving.max(initial=0.0) < 12, f"a sensor that is {fault.kind} was not noticed")

    def end(self) -> None:
        """Every run ends, and in words."""
        left = self._left
        if isinstance(left.raised, Stuck):
            self.broken.append(str(left.raised))
        elif left.raised is not None and not left.was_killed:
            expected = isinstance(left.raised, (OSError, InputError)) and bool(self._kinds & SPOILS_DISK)
            self._require(expected, f"raised {left.raised!r}")
        if left.summary is not None and not self._kinds - {"look", "recover_now", "second", "flip", "clock_step"}:
            planned = left.plan.drive_limit_v > 9.0
            self._require(left.summary.how == "complete" or not planned, f"undisturbed, but {left.summary.why}")

    def file(self) -> None:
        """Every acknowledged frame is there, in its place; so it is after recovery; the counts add up."""
        path, acknowledged = self._left.path, self._left.acknowledged
        if self._left.was_removed:
            rescued = sorted(self._disk.folder.glob("run.rescued-*"))
            path = rescued[0] if rescued else path
            if "full" in self._kinds and "no copy of it could be made" in str(self._left.raised):
                acknowledged = 0
            if not path.exists():
                self._require(acknowledged == 0 or self._left.was_killed, "a removed file was not rescued")
                return
        if not path.exists():
            self._require(acknowledged == 0, "acknowledged, but there is no file")
            return
        self._states.append(self._looked(path, acknowledged, whole=True))

    def copies(self) -> None:
        """What others saw of the growing file."""
        for _, path, acknowledged in self._left.copies:
            state = self._looked(path, acknowledged)
            self._require(state not in ("complete", "stopped"), f"a growing file was called {state}")
            self._states.append(state)

    def flipped(self) -> None:
        """Bytes of the file that change later are found, and read right or not at all."""
        path = self._left.path
        for fault in self._left.plan.faults:
            if fault.kind != "flip" or not path.exists():
                continue
            data = bytearray(path.read_bytes())
            at = int(fault.at * len(data))
            for k in range(at, min(at + (fault.n if fault.n % 2 else 1), len(data))):
                data[k] ^= 1 + fault.n % 255
            path.write_bytes(bytes(data))
            self._states.append(self._looked(path, 0, is_damaged=True))

    def _looked(self, path: Path, acknowledged: int, *, whole: bool = False, is_damaged: bool = False) -> str:
        """What `verify` says, having compared with the truth what is read and what is recovered."""
        unsure = is_damaged or self._left.power_failed

        def look() -> tuple[str, list[str], int]:
            return self._readable(path, acknowledged, whole, unsure), self.broken, self._n_recovered

        def look_here() -> tuple[str, list[str], int]:
            with read_here():
                return look()

        # HDF5 may hang or crash of damaged tables: a copy of this process reads them, or one of its own, as for a user
        copied = in_copy(look_here, patience_s=3.0) if unsure else look_here()
        state, self.broken, self._n_recovered = copied or look()
        return state

    def _readable(self, path: Path, acknowledged: int, whole: bool, unsure: bool) -> str:
        name = path.name
        try:
            report, read = self._read(path)
        except InputError as error:
            self._require(acknowledged == 0 or unsure, f"{name}: {acknowledged} acknowledged, and verify: {error}")
            return "refused"
        n = 0 if read is None else len(read[0])
        if read is not None:
            self._compare(name, *read)
        if report.state in ("complete", "stopped"):
            self._require(n >= acknowledged, f"{name}: {n} samples read of {acknowledged} acknowledged")
            is_all = read is not None and (n == len(self._codes) or self._lies or self._left.plan.device != "plain")
            complete = self._left.summary is not None and self._left.summary.how == "complete"
            disturbed = bool(self._kinds & SPOILS_DISK) and not complete
            short = bool(self._kinds & {*DEVICE}) and read is not None and read[2].get("suspect")
            self._require(
                is_all or disturbed or short,
                f"{name}: {report.state}, with {n} of {len(self._codes)} samples",
            )
            if whole and read is not None:
                self._count(name, read)
            return report.state
        self._n_recovered += 1
        out = path.with_name(f"recovered{self._n_recovered}.h5")
        out.unlink(missing_ok=True)
        try:
            recover(path, out)
        except InputError as error:
            self._require(n == 0 and acknowledged == 0, f"{name}: {n} samples read, but recover: {error}")
            return report.state
        said, again = self._read(out)
        least = max(n, acknowledged)
        m = 0 if again is None else len(again[0])
        self._require(m >= least, f"{name}: {m} samples recovered; {acknowledged} acknowledged, {n} read")
        if again is not None:
            self._compare(out.name, *again)
        self._require(said.state in ("complete", "stopped"), f"{out.name}: recovered, but {said.state}")
        return report.state

    def _read(self, path: Path) -> tuple[VerifyReport, tuple[np.ndarray, np.ndarray, dict[str, Any]] | None]:
        """What `verify` says; codes, gaps and attributes, or None of what cannot be read."""
        try:
            with open_recording(path) as recording:
                report = report_of(recording)  # as `verify`, which opens it once more for that
                there = [name for name in CHANNELS if name in recording.channels]
                codes = np.column_stack([recording.codes(name) for name in there]) if there else np.zeros((0, 4))
                blocks = recording.blocks
                # frames after a loss that a card's driver may have reported late
                unsure = np.repeat((blocks["flags"] & BlockFlag.FILLED) != 0, blocks["n_samples"])
                said = {"there": there, "unsure": unsure & (self._left.plan.device == "card")}
                return report, (codes, recording.gaps, dict(recording.attrs) | said)
        except InputError:
            return verify(path), None

    def _compare(self, name: str, codes: np.ndarray, gaps: np.ndarray, attrs: dict[str, Any]) -> None:
        """Each frame read is the one that was handed over, and in its place."""
        columns = [CHANNELS.index(channel) for channel in attrs["there"]]
        if self._lies:
            self._require(_in_order(codes, self._codes[:, columns]), f"{name}: frames that were never handed over")
            return
        place = np.arange(len(codes))
        for first, lost in gaps:
            place[int(first) :] += int(lost)
        if self._left.plan.device != "plain" and len(codes):  # its count began before the ramp did
            place += self._begin(codes[:8], columns) - place[0]
        k = np.minimum(np.searchsorted(self._numbers, place), len(self._codes) - 1)
        right = (self._numbers[k] == place) & (codes == self._codes[k][:, columns]).all(axis=1) if len(codes) else place
        wrong = np.flatnonzero(~(right.astype(bool) | attrs["unsure"]))
        self._require(not wrong.size, f"{name}: {wrong.size} of {len(codes)} frames out of place, from {wrong[:1]} on")

    def _begin(self, codes: np.ndarray, columns: list[int]) -> int:
        """Number of the first recorded frame."""
        truth = self._codes[:, columns]
        for k in np.flatnonzero((truth == codes[0]).all(axis=1)):
            if np.array_equal(truth[k : k + len(codes)], codes):
                return int(self._numbers[k])
        self.broken.append("the first frames were never handed over")
        return 0

    def _count(self, name: str, read: tuple[np.ndarray, np.ndarray, dict[str, Any]]) -> None:
        """Expected is recorded and declared lost, of a run that ended by itself."""
        codes, gaps, attrs = read
        if "expected_samples" not in attrs:
            return
        expected, lost = int(attrs["expected_samples"]), int(gaps[:, 1].sum())
        if not attrs.get("suspect") and not self._lies:
            self._require(len(codes) + lost == expected, f"{name}: {len(codes)} and {lost} lost of {expected}")
        if (
            self._left.plan.device == "plain"
            and not self._kinds & {"gone", "doubled"}
            and self._left.summary is not None
        ):
            self._require(
                expected == self._left.ledger.n_out, f"{name}: {expected} expected, {self._left.ledger.n_out} played"
            )

    def fingerprint(self) -> str:
        """Of all that was played, handed over and left."""
        sums = hashlib.sha256(self._codes.tobytes())
        for out in self._left.ledger.out:
            sums.update(out.tobytes())
        for path in sorted(self._disk.folder.glob("[!r]*")) + sorted(self._disk.folder.glob("run*")):
            sums.update(path.name.replace(str(os.getpid()), "").encode() + path.read_bytes())
        sums.update(repr(self._states).encode())
        return sums.hexdigest()[:16]


def _in_order(some: np.ndarray, of: np.ndarray) -> bool:
    """Whether rows are among others, in their order."""
    rows = iter(map(bytes, np.ascontiguousarray(of)))
    return all(row in rows for row in map(bytes, np.ascontiguousarray(some)))
