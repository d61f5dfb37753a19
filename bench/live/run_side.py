"""The run's end of the board: what a watched run tells, and how it takes commands, between two blocks.

Nothing here waits for the page. A page that is slow, hangs or is gone changes nothing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.live.board import LONGEST_NOTE, Board, Message
from bench.terminal.orders import steps_from
from daq.recorder.recorder_process import RecorderProcess
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from rig.backends.base import Backend
from rig.execution.operator import RunSummary, Status, StopRequest
from rig.programme.sequencer import Stop

EVERY_S = 0.05  # between two states of the run
STOPS = {"finish": Stop.FINISH_STEP, "ramp_down": Stop.RAMP_DOWN, "now": Stop.NOW}
PAGE = "page"
WORDS = {"finish": "page: step finished", "ramp_down": "page: ramped down", "now": "page: stopped now"}


class WatchedRecorder(RecorderProcess):
    """A recorder whose frames and steps others can watch; as `RecorderProcess` in all else."""

    def __init__(self, path: Path | str, setup: Setup, board: Board, **options: Any) -> None:
        super().__init__(path, setup, private=False, **options)
        self._board = board

    def mark_step(self, step: np.void | Mapping[str, Any]) -> None:
        """As `RecorderProcess.mark_step`; the row goes on the board too."""
        super().mark_step(step)
        names = step.dtype.names or () if isinstance(step, np.void) else tuple(step)
        row = {name: _json(step[name]) for name in names}
        self._board.events.put({"kind": "step", **row})


class RunSide:
    """Events out and commands in, for one run (`bench.jobs.run_ramp.Onlooker`).

    Parameters
    ----------
    board
        Between run and page.
    also
        Called after each block too.
    """

    def __init__(self, board: Board, also: Callable[[Status], None] | None = None) -> None:
        self._board = board
        self._also = also or _silent
        self._request = StopRequest()
        self._progress: Callable[[Status], None] = _silent
        self._told_at = -math.inf
        self._told: tuple[object, ...] = ()

    def recorder(self, path: Path, setup: Setup, **options: Any) -> RecorderProcess:
        """The recorder of a run that is watched."""
        return WatchedRecorder(path, setup, self._board, **options)

    def begin(
        self, recorder: RecorderProcess, backend: Backend, request: StopRequest, progress: Callable[[Status], None]
    ) -> Callable[[Status], None]:
        """Tell of the run and where its frames are; returns what is to be called after each block."""
        self._request, self._progress = request, progress
        ring, out = recorder.ring, recorder.path
        self._board.events.put(
            {
                "kind": "run",
                "out": str(out.absolute()),
                "backend": backend.name,
                "simulated": backend.simulated,
                "channels": list(backend.channels),
                "scales": {name: list(scale) for name, scale in backend.scales.items()},
                "ring": [ring.slots, ring.block_samples, ring.channels, ring.name],
                "leads": request.leads,
            }
        )
        return self._after_block

    def _after_block(self, status: Status) -> None:
        """After a block: take commands, tell the state of the run where it is due, draw."""
        if self._board.commands.waiting:
            for command in self._board.commands.read()[0]:
                self._obey(command)
        now = time.monotonic()
        told = (status.state, status.step.index, self._request.pause, self._request.wanted)
        if now - self._told_at >= EVERY_S or told != self._told:
            self._told_at, self._told = now, told
            self._board.events.put(state_of(status, self._request))
        self._also(status)
        self._progress(status)

    def end(self, summary: RunSummary | None, fault: str = "") -> None:
        """Tell how the run ended."""
        if summary is None:
            self._board.events.put({"kind": "ended", "how": "failed", "why": fault, "n_samples": 0})
            return
        self._board.events.put(
            {
                "kind": "ended",
                "how": summary.how,
                "why": summary.why,
                "n_samples": summary.n_samples,
                "steps_driven": summary.steps_driven,
                "lost_samples": summary.lost_samples,
            }
        )

    def _obey(self, command: Message) -> None:
        """Do what the page asks; what is not known is left alone."""
        wanted, text, request = command.get("do"), str(command.get("text", "")), self._request
        if wanted in STOPS:
            request.ask(STOPS[wanted], WORDS[wanted])
        elif wanted == "pause":
            request.hold(PAGE)
        elif wanted == "go_on":
            request.go_on(PAGE)
        elif wanted == "note" and text.strip():
            request.notes = [*request.notes, text.strip()]
        elif wanted == "next":
            try:
                request.take_over(PAGE, steps_from(text))
            except InputError as error:
                wanted, text = "refused", str(error)
        else:
            return
        self._board.events.put({"kind": "taken", "do": wanted, "text": text[:LONGEST_NOTE]})


def _silent(status: Status) -> None:
    """Draw nothing."""


def state_of(status: Status, request: StopRequest) -> Message:
    """A run's state as an event."""
    return {
        "kind": "state",
        "state": status.state.value,
        "step": status.step.index,
        "n_steps": status.n_steps,
        "gamma": status.step.gamma,
        "step_first": status.step.first_sample,
        "step_end": status.step.end_sample,
        "sample": status.sample,
        "n_samples": status.n_samples,
        "left_samples": status.left_samples,
        "achieved_gamma": _json(status.achieved_gamma),
        "achieved_gamma_uncertainty": _json(status.achieved_gamma_uncertainty),
        "plate_mps2": _json(status.plate_mps2),
        "limits": {name: round(float(part), 4) for name, part in status.limits_in_use.items()},
        "contact_age_cycles": round(float(status.contact_age_cycles), 2),
        "lost_samples": status.lost_samples,
        "pausing": request.pause,
        "stopping": None if request.wanted is None else request.wanted.name.lower(),
    }


def _json(value: Any) -> Any:
    """A number as JSON has it: plain, and none where it is not finite."""
    plain = value.item() if hasattr(value, "item") else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
