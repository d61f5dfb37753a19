"""One run of the product on the simulated bench: everything that acts in it, and what is left when it is over."""

from __future__ import annotations

import contextlib
import gc
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.live.board import Board, RunSide
from bench.terminal.run_console import stop_on_signals
from benchmarks.bench_simulation.cards import make_card
from benchmarks.bench_simulation.devices import Ledger, PlainDevice, Plate
from benchmarks.bench_simulation.disk import Disk, Refusal
from benchmarks.bench_simulation.plan import DEVICE, Fault, Plan, profile_text
from benchmarks.bench_simulation.recorder import RecorderOnBench
from benchmarks.bench_simulation.world import Killed, World
from daq.recorder.recorder_process import RecorderProcess
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from rig.execution.operator import RunSummary, Status, StopRequest
from rig.execution.run import run_ramp
from rig.profile import Profile, parse_profile
from rig.programme.ramp import plan as programme_of
from rig.programme.sequencer import State, Stop, largest_block

BEGAN_NS = 1_800_000_000 * 10**9
SIGNALS = {"SIGINT": ("SIGINT",), "SIGTERM": ("SIGTERM",), "SIGHUP": ("SIGHUP",), "twice": ("SIGINT", "SIGINT")}
PAGE = {
    "page_finish": {"do": "finish"}, "page_down": {"do": "ramp_down"}, "page_now": {"do": "now"},
    "page_note": {"do": "note", "text": "from the page"}, "page_junk": {"do": "everything", "text": "\0" * 1000},
}  # fmt: skip
STOPS = {"finish": Stop.FINISH_STEP, "down": Stop.RAMP_DOWN, "now": Stop.NOW}
SOON = ("down", "now", "SIGINT", "SIGTERM", "SIGHUP", "twice", "page_down", "page_now")  # the drive must end


class _Here(RecordingWriter):
    """A recording that is written by the run's own process."""

    after_mark: Callable[[], None]

    def mark_step(self, step: Any) -> None:
        """As of any recording."""
        super().mark_step(step)
        self.after_mark()


@dataclass
class Left:
    """What a run left, for the judge."""

    plan: Plan
    profile: Profile
    path: Path
    ledger: Ledger
    n_planned: int
    buffer_samples: int  # that the device plays after what it was handed over last
    summary: RunSummary | None = None
    raised: BaseException | None = None
    began: bool = False
    was_killed: bool = False
    acknowledged: int = 0  # samples
    power_failed: bool = False
    was_removed: bool = False
    copies: list[tuple[str, Path, int]] = field(default_factory=list)  # seen meanwhile: how, where, acknowledged then
    said: list[str] = field(default_factory=list)  # what broke while it ran
    seconds: float = 0.0


class Bench:
    """A plan, set up and run once."""

    def __init__(self, plan: Plan, disk: Disk) -> None:
        self.plan, self.disk = plan, disk
        disk.reset()
        self._text = profile_text(plan)
        self._profile = parse_profile(self._text, "simulation.toml")
        self._programme = programme_of(self._profile)
        self._n_planned = self._programme.n_samples
        self._rng = np.random.default_rng([plan.seed, 1])
        self._world = World(plan.begin_ns, BEGAN_NS, plan.drift)
        # three times as planned, the longest pause, and what a recorder waits for after its run's death
        self._world.latest_ns = round(3e9 * self._n_planned / plan.rate_hz) + 3_000 * 10**9
        self._request = StopRequest()
        self._board: Board | None = None
        self._block = largest_block(self._programme.clock, self._profile.backend.block_samples)
        self._writer: RecorderProcess | RecordingWriter | None = None
        self._recorder = RecorderOnBench(self._world, round(0.4e9 * self._block / plan.rate_hz))
        self._recorder.after_turn, self._recorder.after_mark = self._note_safe, self._note_synced
        self._safe = self._synced = 0
        self._stopping_at: int | None = None
        ledger = Ledger(plan.rate_hz)
        plate = Plate(plan.faults, self._n_planned, np.random.default_rng([plan.seed, 2]))
        due = [(round(f.at * self._n_planned), f) for f in plan.faults if f.kind in DEVICE]
        buffer = 0
        if plan.device == "plain":
            self._device: Any = PlainDevice(self._world, ledger, plate, due, simulated=plan.recorder == "here")
        else:
            self._device, buffer = make_card(plan, self._profile, self._world, ledger, plate, due)
        self.left = Left(plan, self._profile, disk.folder / "run.h5", ledger, self._n_planned, buffer)

    def run(self) -> Left:
        """Run it."""
        left, plan, world = self.left, self.plan, self._world
        for fault in plan.faults:
            self._prepare(fault)
        needs_page = any(f.kind.startswith("page") for f in plan.faults)
        try:
            if needs_page:
                self._board = Board()
            with stop_on_signals(self._request):
                self._drive()
        except (Killed, Exception) as error:  # noqa: BLE001 (whatever ends a run is for the judge to say)
            left.raised = error
        finally:
            if self._board is not None:
                self._board.close()
        left.was_killed = world.run_is_dead
        self._recorder.run_is_gone = True
        left.seconds = world.now_ns * 1e-9
        if not self._recorder.is_dead and not self._recorder.ended:
            with contextlib.suppress(Killed):
                world.settle(lambda: self._recorder.ended, round(700e9))
        left.acknowledged = self._safe
        self._bury()
        return left

    def _drive(self) -> None:
        """As `bench.jobs.run_ramp.record`, with the parts of the bench passed in."""
        plan, device = self.plan, self._device
        options: dict[str, Any] = {
            "profile_text": self._text, "channels": device.channels, "scales": device.scales, "backend": device.name,
            "simulated": device.simulated, "expected_samples": self._n_planned,
        }  # fmt: skip
        side = RunSide(self._board, clock=self._world) if self._board is not None else None
        if plan.recorder == "process":
            make: Callable[..., RecorderProcess] = RecorderProcess if side is None else side.recorder
            # large enough for what one turn of the recorder cannot take, or small enough to be filled
            ring_s = (4.0 + 10.0 / plan.frequency_hz) * (4 if plan.seed % 2 else 1)
            writer = self._writer = make(
                self.left.path, self._profile.setup(), block_samples=self._block, patience_s=0.0,
                start=self._recorder.start, clock=self._world, ring_s=ring_s, **options,
            )  # fmt: skip
            progress = self._progress if side is None else side.begin(writer, device, self._request, self._progress)
            self.left.began = True
            self.left.summary = run_ramp(
                self._profile, device, writer, progress=progress, stop_request=self._request, clock=self._world
            )
        else:
            here = self._writer = _Here(self.left.path, self._profile.setup(), clock=self._world, **options)
            here.after_mark = self._note_synced
            self.left.began = True
            self.left.summary = run_ramp(
                self._profile, device, here, progress=self._progress, stop_request=self._request, clock=self._world
            )
        self._note_safe()

    def _progress(self, status: Status) -> None:
        """After each block: what is safe, and when the run said first that it stops."""
        self._note_safe()
        if status.state in (State.STOPPING, State.RESTING) and self._stopping_at is None:
            self._stopping_at = self.left.ledger.n_out
            self.left.ledger.causes.append(("stopping", self.left.ledger.n_out))

    def _note_safe(self) -> None:
        """What the product has acknowledged by now."""
        writer = self._writer
        if self.disk.frozen or writer is None:
            return
        if isinstance(writer, RecordingWriter):
            self._safe = max(self._safe, writer.n_samples)
        elif writer.is_open:
            self._safe = max(self._safe, writer.safe_samples)

    def _note_synced(self) -> None:
        """What was acknowledged when a step had been marked survives a loss of power, too."""
        self._note_safe()
        if not self.disk.frozen:
            self._synced = self._safe

    def _die(self, *, run: bool) -> None:
        """Nothing reaches the disk any more; the recorder is dead, and the run as well or not."""
        self.disk.frozen = True
        self._recorder.is_dead = True
        self._world.run_is_dead = run or self.plan.recorder == "here"
        if not self._world.run_is_dead and self.left.summary is None:
            self.left.ledger.causes.append(("the recorder's death", self.left.ledger.n_out + self._block))

    def _bury(self) -> None:
        """What dead processes held is let go, while nothing of theirs reaches the disk; then the power fails, too."""
        was_frozen = self.disk.frozen
        if was_frozen:
            self._recorder.abandon()
        self._writer = self._device = None  # type: ignore[assignment]
        self._recorder = RecorderOnBench(self._world, 1)
        if was_frozen:
            if self.left.raised is not None:
                self.left.raised = self.left.raised.with_traceback(None)
                self.left.raised.__context__ = self.left.raised.__cause__ = None
            gc.collect()
        self.disk.on_call = lambda call: None
        # a recorder that is a process takes with it what HDF5 could not write to a full disk
        if (was_frozen or self.plan.recorder == "process") and self.left.path.exists():
            self.disk.replace(self.left.path, self.left.path.read_bytes())
        if self.left.power_failed and was_frozen:
            self.left.acknowledged = self._synced
            self.disk.cut_power(self._rng)
        self.disk.frozen = False
        self.disk.refusals = []
        self.disk.logged = ""
        self.disk.free(1 << 32)

    def _prepare(self, fault: Fault) -> None:
        """Arrange for a fault to happen."""
        kind, at, ns = fault.kind, fault.at, round(fault.at * self._n_planned / self.plan.rate_hz * 1e9)
        call = 1 + int(at * (60.0 + 2.0 * self._n_planned / self._block))
        if kind in ("full", "unwritable", "interrupted", "short_write"):
            how = "short" if kind == "short_write" else kind
            calls = 10**9 if kind == "full" else fault.n if kind == "short_write" else 1
            self.disk.refusals.append(Refusal(how, call, calls))
        elif kind in ("killed", "power"):
            if kind == "power":
                self.disk.logged = "run.h5"
                self.left.power_failed = True

            def on_call(n: int) -> None:
                if n >= call and not self.disk.frozen:
                    self._die(run=True)

            self.disk.on_call = on_call
        elif kind == "little_space":
            self.disk.free(8_100_000 + 50 * fault.n)
        elif kind in DO:
            self._world.at(ns, lambda: DO[kind](self, fault))
        elif kind in SIGNALS or kind in STOPS or kind in PAGE or kind in ("pause", "page_pause", "note"):
            self._world.at(ns, lambda: self._ask(fault))

    def _ask(self, fault: Fault) -> None:
        """What the operator does."""
        kind, ledger = fault.kind, self.left.ledger
        if self._recorder.run_is_gone or not self.left.began:
            return
        if kind in SOON and (kind[:4] != "page" or self.plan.recorder == "process"):
            ledger.causes.append((kind, ledger.n_out))
        for name in SIGNALS.get(kind, ()):
            signal.raise_signal(signal.Signals[name])
        if kind in STOPS:
            self._request.ask(STOPS[kind], "operator")
        elif kind == "note":
            self._request.notes = [*self._request.notes, "a note " * fault.n]
        elif kind == "pause":
            self._request.hold("operator")
            self._world.at(self._world.now_ns + fault.n * 10**9, lambda: self._request.go_on("operator"))
        elif kind == "page_pause" and self._board is not None:
            self._board.commands.put({"do": "pause"})
            back = {"do": "go_on"}
            if fault.n % 3:
                self._world.at(self._world.now_ns + fault.n * 10**9, lambda: self._put(back))
        elif kind in PAGE:
            self._put(PAGE[kind])

    def _put(self, command: dict[str, str]) -> None:
        if self._board is not None and not self._recorder.run_is_gone:
            self._board.commands.put(command)

    def _copy(self, how: str) -> None:
        """The file as another process sees it now."""
        if self.left.path.exists() and not self.disk.frozen and not self._recorder.run_is_gone:
            copy = self.disk.folder / f"copy{len(self.left.copies)}.h5"
            self.disk.is_aside = True
            copy.write_bytes(self.left.path.read_bytes())
            self.disk.is_aside = False
            self.left.copies.append((how, copy, self._safe))

    def _second(self, fault: Fault) -> None:
        """Another run is started on the same file: it must be refused, and this one go on."""
        if not self.left.path.exists() or self.disk.frozen:
            return
        with contextlib.suppress(InputError):
            RecordingWriter(self.left.path, self._profile.setup(), profile_text="", channels=("drive",), backend="x",
                            simulated=True, clock=self._world)  # fmt: skip
            self.left.said.append("a second run was let onto the same file")

    def _remove(self, fault: Fault) -> None:
        if not self.disk.frozen and not self._recorder.run_is_gone and self.left.path.exists():
            self.left.was_removed = True
            self.disk.is_aside = True
            self.left.path.unlink()
            self.disk.is_aside = False

    def _stall(self, fault: Fault) -> None:
        self._recorder.stalls_ns = fault.n * 3 * 10**7

    def _step_clock(self, fault: Fault) -> None:
        self._world.wall_ns += (fault.n - 1000) * 10**12

    def _run_killed(self, fault: Fault) -> None:
        if self.plan.recorder == "here":
            self._die(run=True)
        self._world.run_is_dead = True


DO: dict[str, Callable[[Bench, Fault], None]] = {
    "look": lambda bench, fault: bench._copy("look"), "recover_now": lambda bench, fault: bench._copy("recover"),
    "second": Bench._second, "removed": Bench._remove, "recorder_stalls": Bench._stall,
    "clock_step": Bench._step_clock, "run_killed": Bench._run_killed,
    "recorder_dies": lambda bench, fault: bench._die(run=False),
}  # fmt: skip
