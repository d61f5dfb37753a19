"""Run a ramp: sequencer, clamp, back end, recorder and watch in one loop, block by block.

The rule kept here: however a run ends (done, asked to, tripped, or an exception anywhere), the drive goes softly to
zero while the device answers, and the recording is closed with the reason in it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from daq.block import Block
from daq.recording import RecordingWriter
from rig.backends.base import Backend, BackendError, Running
from rig.interlock import Interlock
from rig.motion import MotionWatch
from rig.profile import Profile
from rig.ramp import Programme, Step, plan
from rig.sequencer import Sequencer, State, Stop, largest_block


class StopRequest:
    """Where anybody (a signal, a page, a test) asks a run to stop; the strongest wish stands."""

    def __init__(self) -> None:
        self.wanted: Stop | None = None
        self.why = ""

    def ask(self, how: Stop, why: str) -> None:
        """Ask for a stop; a weaker wish than the one that stands is ignored."""
        if self.wanted is None or how > self.wanted:
            self.wanted, self.why = how, why


@dataclass(frozen=True)
class Status:
    """Where a run is, once a block."""

    state: State
    step: Step
    n_steps: int
    sample: int
    n_samples: int
    plate_mps2: float
    lost_samples: int


@dataclass(frozen=True)
class RunSummary:
    """How a run went."""

    how: Literal["complete", "stopped", "failed"]
    why: str
    n_samples: int
    steps_driven: int
    steps_planned: int
    lost_samples: int
    wall_s: float


def run_ramp(
    profile: Profile,
    backend: Backend,
    writer: RecordingWriter,
    *,
    progress: Callable[[Status], None] | None = None,
    stop_request: StopRequest | None = None,
) -> RunSummary:
    """Drive ``profile``'s ramp through ``backend`` and record it; closes ``writer``.

    Parameters
    ----------
    profile
        What to drive; a programme that a limit forbids must have been refused before (`rig.ramp.forbidden`).
    backend
        Not yet started.
    writer
        An open recording without samples.
    progress
        Called after each block.
    stop_request
        Read before each block.

    Returns
    -------
    RunSummary
        ``complete``; ``stopped`` when asked to or tripped by the interlock; ``failed`` when the device or the disk
        failed. Whatever was recorded is kept.
    """
    run = _Run(profile, backend, writer, progress or _silent, stop_request or StopRequest())
    began = time.monotonic()
    with writer:
        try:
            with Running(backend):
                run.drive()
        except BackendError as error:
            run.end("failed", f"back end {backend.name}: {error}")
        writer.close(run.how, run.why)
    return run.summary(time.monotonic() - began)


def _silent(status: Status) -> None:
    """No progress wanted."""


class _Run:
    """The loop of `run_ramp` and what it knows."""

    def __init__(
        self,
        profile: Profile,
        backend: Backend,
        writer: RecordingWriter,
        progress: Callable[[Status], None],
        stop_request: StopRequest,
    ) -> None:
        self.how: Literal["complete", "stopped", "failed"] = "complete"
        self.why = ""
        self._programme: Programme = plan(profile)
        self._sequencer = Sequencer(self._programme, profile)
        self._interlock = Interlock(profile, backend.channels, backend.scales)
        self._accelerometer = backend.channels.index("accelerometer")
        scale = backend.scales["accelerometer"][0] / profile.channels.accelerometer.volts_per_mps2
        self._watch = MotionWatch(profile, scale)
        self._profile, self._backend, self._writer = profile, backend, writer
        self._progress, self._request = progress, stop_request
        self._obeyed: Stop | None = None
        self._recording = True
        self._device_lost = False
        self._lost = 0
        self._steps = 0
        self._block = largest_block(self._programme.clock, profile.backend.block_samples)

    def end(self, how: Literal["stopped", "failed"], why: str) -> None:
        """Keep the first reason for which the run is not complete; a failure outranks a stop."""
        if self.how == "complete" or (how == "failed" and self.how == "stopped"):
            self.how, self.why = how, why

    def drive(self) -> None:
        """Exchange blocks until the drive rests at zero."""
        try:
            while not self._sequencer.done:
                self._obey()
                self._exchange()
                self._progress(self._status())
        finally:
            self._land()

    def summary(self, wall_s: float) -> RunSummary:
        """What came of it."""
        return RunSummary(
            self.how, self.why, self._writer.n_samples, self._steps, len(self._programme.steps), self._lost, wall_s
        )

    def _land(self) -> None:
        """Whatever happened: bring the drive softly to zero while the device answers, and note where the step ended."""
        if self._device_lost:
            step = self._sequencer.step
            self._mark(replace(step, n_samples=min(step.n_samples, self._writer.n_samples - step.first_sample)))
            return
        if not self._sequencer.done:
            self._sequencer.stop(Stop.RAMP_DOWN)
        while not self._sequencer.done:
            self._exchange()

    def _obey(self) -> None:
        """Pass a new stop request on to the sequencer."""
        wanted = self._request.wanted
        if wanted is not None and wanted != self._obeyed:
            self._obeyed = wanted
            zero = f"; drive zero from sample {self._sequencer.position}" if wanted is Stop.NOW else ""
            self.end("stopped", f"{self._request.why}{zero}")
            self._sequencer.stop(wanted)

    def _exchange(self) -> None:
        """One block: drive out through the clamp, frames in, on record, watched."""
        drive = self._interlock.clamp(self._sequencer.take(self._block))
        self._device_lost = True  # until it has answered
        block = self._backend.exchange(drive)
        self._device_lost = False
        self._lost += block.lost_before
        self._record(block)
        self._motion = self._watch.update(block.codes[:, self._accelerometer])
        trip = self._interlock.inspect(drive, block, self._motion)
        if trip is not None:
            self.end("stopped", f"interlock: {trip}")
            self._sequencer.stop(Stop.RAMP_DOWN)

    def _record(self, block: Block) -> None:
        """Keep the block and the marks that fall in it; a disk that refuses stops the run, softly."""
        marks, self._sequencer.marks = self._sequencer.marks, []
        if not self._recording:
            return
        try:
            self._writer.append(block)
            for step in marks:
                self._mark(step)
        except OSError as error:
            self._recording = False
            self.end("failed", f"recording: {error}")
            self._sequencer.stop(Stop.RAMP_DOWN)

    def _mark(self, step: Step) -> None:
        """Write a step's row: as planned when it begins, as driven when it ends."""
        if step.n_samples <= 0 or not self._recording:
            return
        self._steps = step.index + 1
        self._writer.mark_step(
            {
                "first_sample": step.first_sample,
                "n_samples": step.n_samples,
                "settle_samples": min(step.settle_samples, step.n_samples),
                "fade_samples": step.fade_samples,
                "gamma": step.gamma,
                "frequency_hz": self._profile.forcing.frequency_hz,
                "ratio": self._profile.forcing.ratio,
                "cycles": float(step.hold_cycles),
                "settle_cycles": float(step.settle_cycles),
                "direction": step.direction,
            }
        )

    def _status(self) -> Status:
        return Status(
            state=self._sequencer.state,
            step=self._sequencer.step,
            n_steps=len(self._programme.steps),
            sample=self._sequencer.position,
            n_samples=self._programme.n_samples,
            plate_mps2=self._motion.acceleration_mps2,
            lost_samples=self._lost,
        )
