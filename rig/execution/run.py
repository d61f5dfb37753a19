"""The run of a ramp: sequencer, clamp, back end, recorder and monitor in one loop, block by block.

However a run ends (done, asked to, tripped, or an exception anywhere), the drive goes softly to
zero while the device answers, and the recording is closed with the reason in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal, TypeAlias

import numpy as np

from daq.clocks.loss_search import Searcher
from daq.files.tables import Block, note_rows
from daq.recorder.recorder_process import RecorderProcess
from daq.recording.writer import RecordingWriter
from daq.setup.clock import SYSTEM, Clock
from kernels.arrays import Bools, Floats
from rig.backends.base import Backend, BackendError, Lagging, TwoClocked, running
from rig.execution.amplitude_loop import AmplitudeLoop, achieved_gamma
from rig.execution.branch_hold import BranchHold
from rig.execution.interlock import Interlock
from rig.execution.loss_account import ClockLog, LossAccount
from rig.execution.operator import RunSummary, Status, StopRequest
from rig.execution.plate_monitor import MeterBlock, Motion, MotionWatch, ToneMeter
from rig.profile import Profile
from rig.programme.ramp import Step, plan
from rig.programme.sequencer import LONGEST_PAUSE_S, MOVING, STILL, Sequencer, State, Stop, change_rows, largest_block

INTEGRATED = ("velocity_mps", "displacement_m")  # limits whose use is integrated from the accelerometer

Recorder: TypeAlias = RecordingWriter | RecorderProcess
"""Where a run is recorded: here, or in a process of its own."""


def run_ramp(
    profile: Profile,
    backend: Backend,
    writer: Recorder,
    *,
    progress: Callable[[Status], None] | None = None,
    stop_request: StopRequest | None = None,
    hold: BranchHold | None = None,
    clock: Clock = SYSTEM,
) -> RunSummary:
    """Drive ``profile``'s ramp through ``backend`` and record it; closes ``writer``.

    Raises `daq.setup.errors.InputError` before anything moves, where the device's delay exceeds what the branch's
    multiplier allows. The run's end is ``complete``; ``stopped`` when asked to or tripped by the interlock; ``failed``
    when the device or the disk failed. Whatever was recorded stays readable.

    Parameters
    ----------
    profile
        What to drive; a programme that a limit forbids must have been refused before (`rig.programme.ramp.forbidden`).
    backend
        Not yet started.
    writer
        An open recording without samples, here or in a process of its own.
    progress
        Called after each block.
    stop_request
        Read before each block.
    hold
        What holds the ball on a branch, where it is to be held.
    clock
        The machine's, or that of a simulation.
    """
    run = _Run(profile, backend, writer, progress or (lambda status: None), stop_request or StopRequest(), hold, clock)
    began = clock.monotonic_s()
    with writer:
        try:
            with running(backend):
                run.drive()
        except BackendError as error:
            run.end("failed", f"back end {backend.name}: {error}")
        writer.close(run.how, run.why, expected_samples=run.account.expected_samples)
    return run.summary(clock.monotonic_s() - began)


class _Run:
    """The loop of `run_ramp`, its parts (programme, drive, measurement, safety), and its state."""

    def __init__(
        self,
        profile: Profile,
        backend: Backend,
        writer: Recorder,
        progress: Callable[[Status], None],
        stop_request: StopRequest,
        hold: BranchHold | None,
        clock: Clock,
    ) -> None:
        self.how: Literal["complete", "stopped", "failed"] = "complete"
        self.why = ""
        self._asked = False
        self._profile, self._backend, self._writer = profile, backend, writer
        self._progress, self._request, self._hold, self._clock = progress, stop_request, hold, clock
        self._programme = programme = plan(profile)
        self._loop = loop = AmplitudeLoop(profile, profile.control) if profile.control else None
        amplitudes = loop.amplitudes if loop else None
        self._sequencer = Sequencer(programme, profile, amplitudes=amplitudes, controlled=loop is not None)
        # short windows in a hold: their scatter is in the uncertainty
        self._meter = ToneMeter(profile, min(4, profile.ramp.hold_cycles))
        self._interlock = Interlock(profile, backend.channels, backend.scales)
        self._accelerometer = backend.channels.index("accelerometer")
        self._mps2_per_code = backend.scales["accelerometer"][0] / profile.channels.accelerometer.volts_per_mps2
        self._watch = MotionWatch(profile, self._mps2_per_code)
        self._clocks = ClockLog(backend) if isinstance(backend, TwoClocked) else None  # else one clock
        searcher = Searcher(None if backend.simulated else clock.executor("loss-search"))
        self.account = LossAccount(profile, backend.channels.index("drive"), backend.scales["drive"], searcher)
        self._metered = -1
        self._last_achieved = math.nan, math.nan
        self._touching: Bools | None = None
        self._motion = Motion(0.0, 0.0, 0.0, 0.0, 0, np.zeros(0, np.bool_))
        self._applied_stop: Stop | None = None
        self._applied_pause = False
        self._recording = True
        self._pending: list[Block] = []
        self._device_lost = False
        self._marks: list[tuple[int, Step, tuple[float, float]]] = []
        self._steps = 0
        self._block = largest_block(programme.clock, profile.backend.block_samples)

    def end(self, how: Literal["stopped", "failed"], why: str, *, asked: bool = False) -> None:
        """Keep the first reason for which the run is not complete; a failure outranks a stop, a trip is added to it."""
        if self.how == "complete" or (how == "failed" and self.how == "stopped"):
            self.how, self.why, self._asked = how, why, asked
        elif self._asked and not asked:
            self.why, self._asked = f"{self.why}; then {why}", False

    def drive(self) -> None:
        """Exchange blocks until the drive rests at zero."""
        if isinstance(self._backend, Lagging):
            self.account.lags(round(self._backend.lag_samples))
        if self._hold is not None:
            highest = max(step.gamma for step in self._programme.steps)
            self._hold.check_delay(self.account.lag_samples + 2 * self._block, highest)
        block: Callable[[], object] = self._exchange
        try:
            while not self._sequencer.done:
                self._apply_requests()
                block()
                self._progress(self._status())
            if self._sequencer.given_up:
                self.end("stopped", f"held for {LONGEST_PAUSE_S:g} s, without being resumed")
        except Exception:
            block = self._play  # what raised would raise again
            raise
        finally:
            self._ramp_down(block)
            self._release(everything=True)

    def summary(self, wall_s: float) -> RunSummary:
        """Outcome of the run."""
        return RunSummary(
            self.how, self.why, self._asked, self._writer.n_samples, self._steps, len(self._programme.steps),
            self.account.lost_samples, wall_s, self._hold.unheld if self._hold else "",
        )  # fmt: skip

    def _ramp_down(self, block: Callable[[], object]) -> None:
        """Ramp the drive to zero while the device answers; where it was lost, note where the step ended."""
        if self._device_lost:
            self._record(self.account.flush())
            step = self._sequencer.step
            n_samples = min(step.n_samples, self.account.settled_sample - step.first_sample)
            self._marks.append((step.end_sample, replace(step, n_samples=n_samples), self._achieved(step)))
            return
        if not self._sequencer.done:
            self._sequencer.stop(Stop.RAMP_DOWN)
        while not self._sequencer.done:
            block()
        self._record(self.account.flush())

    def _apply_requests(self) -> None:
        """Pass a new request on to the sequencer, and notes to the recording."""
        request = self._request
        if request.pause != self._applied_pause:
            self._applied_pause = request.pause
            self._sequencer.pause(request.pause)
        if request.notes:
            self._note(request.notes)
            request.notes = []
        wanted = request.wanted
        if wanted is not None and wanted != self._applied_stop:
            self._applied_stop = wanted
            zero = f"; drive zero from sample {self._sequencer.position}" if wanted is Stop.NOW else ""
            self.end("stopped", f"{request.why}{zero}", asked=True)
            self._sequencer.stop(wanted)

    def _note(self, texts: list[str]) -> None:
        """Write the operator's words, or the holder's, into the recording."""
        self.flush()
        rows = note_rows(self._writer.n_samples, texts, self._clock.unix_ns())
        self._write(lambda: self._writer.mark_rows("notes", rows))

    def _play(self) -> tuple[Floats, Block, float]:
        """One block: drive out through the clamp, frames in, on record; and the seconds that the frames took."""
        drive = self._interlock.clamp(self._sequencer.take(self._block))
        self.account.played(drive)
        self._device_lost = True  # until it has answered
        asked = self._clock.monotonic_s()
        block = self._backend.exchange(drive)
        waited_s = self._clock.monotonic_s() - asked
        self._device_lost = False
        self._record(self.account.heard(block, len(drive)))
        return drive, block, waited_s

    def _exchange(self) -> None:
        """One block, watched."""
        drive, block, waited_s = self._play()
        self._touching, landed = self._interlock.circuit(block.codes) or (None, None)
        self._motion = self._watch.update(block.codes[:, self._accelerometer], landed, self.account.lost_before)
        self._measure(block)
        marks, self._sequencer.marks = self._sequencer.marks, []
        for step in marks:
            gamma, uncertainty = self._achieved(step)
            self._last_achieved = (gamma, uncertainty) if math.isfinite(gamma) else self._last_achieved
            over = step.end_sample <= self._sequencer.position
            self._marks.append((step.end_sample if over else step.first_sample + 1, step, (gamma, uncertainty)))
        self._release()
        trip = self._interlock.inspect(self.account.driven(block, drive), block, self._motion)
        # a simulation takes the time that it takes
        if trip is None and not self._backend.simulated:
            trip = self._interlock.late(waited_s, len(drive))
        if trip is not None:
            self.end("stopped", f"interlock: {trip}")
            self._sequencer.stop(Stop.RAMP_DOWN)

    def _measure(self, block: Block) -> None:
        """The plate's tones: over each hold for the step table, and while settling for the closed loop."""
        sequencer = self._sequencer
        if sequencer.state is State.HOLDING and self._metered != sequencer.step.index:
            step = sequencer.step
            self._metered = step.index
            self._meter.begin(step.first_sample + step.settle_samples, step.end_sample)
        first = self.account.next_sample - len(block.codes)
        acceleration = np.asarray(block.codes[:, self._accelerometer], np.float64)
        measured = MeterBlock(first, acceleration * self._mps2_per_code, self._motion.quiet, self._touching)
        self._meter.add(measured)
        if self._loop is not None and (fault := self._loop.observe(measured, sequencer)) is not None:
            self.end("stopped", f"closed loop: {fault}")
            sequencer.stop(Stop.RAMP_DOWN)
        if self._hold is not None and (noted := self._hold.observe(measured, sequencer, self._block)):
            self._note(noted)

    def _achieved(self, step: Step) -> tuple[float, float]:
        """Gamma measured over the hold of ``step``, with its uncertainty; NaN where it did not hold."""
        measured = self._meter.estimate() if self._metered == step.index else None
        return achieved_gamma(self._profile, measured) if measured else (math.nan, math.nan)

    def _record(self, blocks: list[Block]) -> None:
        """Keep blocks: at once where measured or handed to another process, else in batches."""
        self._pending += blocks
        at_once = not self._backend.simulated or isinstance(self._writer, RecorderProcess)
        if at_once or sum(len(b.codes) for b in self._pending) >= 8192:
            self.flush()

    def flush(self) -> None:
        """Hand what waits to the recorder; a disk that refuses stops the run, softly."""
        pending, self._pending = self._pending, []
        # without blocks, too: a recorder that is gone is noticed while losses are searched for
        self._write(lambda: self._writer.append(*pending))

    def _release(self, *, everything: bool = False) -> None:
        """Write the rows of steps whose losses are settled, and of the changes of the drive."""
        ready = [mark for mark in self._marks if everything or mark[0] <= self.account.settled_sample]
        self._marks = self._marks[len(ready) :]
        fades, self._sequencer.fades = self._sequencer.fades, []
        if ready or fades or everything:
            self.flush()
        if fades:
            self._write(lambda: self._writer.mark_rows("drive_changes", change_rows(self._profile, fades)))
        for _, step, achieved in ready:
            self._write(partial(self._mark, step, achieved))

    def _write(self, write: Callable[[], object]) -> None:
        """Call the recorder, as long as it takes what it gets; what it raises ends the recording, the drive softly."""
        if not self._recording:
            return
        try:
            write()
        except Exception as error:
            self._recording = False
            if not isinstance(error, OSError):
                raise
            self.end("failed", f"recording: {error}")
            self._sequencer.stop(Stop.RAMP_DOWN)

    def _mark(self, step: Step, achieved: tuple[float, float]) -> None:
        """Write a step's row: as planned when it begins, as driven when it ends."""
        first = self.account.recorded(step.first_sample)
        n = self.account.recorded(step.end_sample) - first
        settle = self.account.recorded(step.first_sample + step.settle_samples) - first
        if n <= 0:
            return
        self._steps = step.index + 1
        rate = 0.0
        if (clocks := self._clocks) is not None:
            for table, rows in clocks.rows(self.account.counted(first + (settle + n) // 2)):
                self._writer.mark_rows(table, rows)
            rate = clocks.rate
        self._writer.mark_step(
            {
                "first_sample": first,
                "n_samples": n,
                "settle_samples": min(settle, n),
                "fade_samples": step.fade_samples,
                "gamma": step.gamma,
                "achieved_gamma": achieved[0],
                "achieved_gamma_uncertainty": achieved[1],
                "frequency_hz": self._profile.forcing.frequency_hz * (1.0 + rate),
                "ratio": self._profile.forcing.ratio,
                "cycles": float(step.hold_cycles),
                "settle_cycles": float(step.settle_cycles),
                "direction": step.direction,
            }
        )

    def _status(self) -> Status:
        programme, step, position = self._programme, self._sequencer.step, self._sequencer.position
        after = programme.n_samples - programme.steps[step.index].end_sample  # as planned, however late it is by now
        moves = self._sequencer.state in MOVING or self._sequencer.state is State.PAUSED
        limits = self._interlock.limits_in_use
        if self._sequencer.state in STILL:  # after a cut the integrated accelerometer rings: the plate stands
            limits = {name: part for name, part in limits.items() if name not in INTEGRATED}
        return Status(
            state=self._sequencer.state,
            step=step,
            n_steps=len(programme.steps),
            sample=position,
            n_samples=programme.n_samples,
            left_samples=max(0, step.end_sample - position) + after if moves else 0,
            plate_mps2=self._motion.acceleration_mps2,
            limits_in_use=limits,
            contact_age_cycles=self._interlock.contact_age_cycles,
            achieved_gamma=self._last_achieved[0],
            achieved_gamma_uncertainty=self._last_achieved[1],
            lost_samples=self.account.lost_samples,
        )
