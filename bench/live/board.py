"""The board between a run and its page: two lanes of short messages in shared memory, neither side ever waits.

The run puts events on one lane, the page puts commands on the other. A lane keeps the newest messages; a reader that
was away too long learns how many it missed. If no one reads, a message costs the microseconds of its writing.
Decision 142.

`RunSide` is the run's end: what a watched run sends, and how it takes commands, between two blocks. A page that is
slow, hangs or is gone changes nothing.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.terminal.run_console import steps_from
from daq.files.json_values import json_object
from daq.files.tables import crc32
from daq.recorder.recorder_process import RecorderProcess
from daq.recorder.shared_ring import shared_memory
from daq.setup.clock import SYSTEM, Clock
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from rig.backends.base import Backend
from rig.execution.operator import RunSummary, Status, StopRequest
from rig.programme.sequencer import Stop

EVENT_SLOTS, EVENT_BYTES = 512, 8192
COMMAND_SLOTS, COMMAND_BYTES = 64, 8192
LONGEST_NOTE = 1900  # characters of a note, of up to four bytes each
_HEAD = 8  # bytes: length and checksum of a message

Message = dict[str, Any]


class Lane:
    """One writer's messages, the newest ``slots`` of them, in ``buffer``."""

    def __init__(self, buffer: memoryview, slots: int, n_bytes: int) -> None:
        self._slots, self._room = slots, n_bytes - _HEAD
        self._put = np.ndarray(1, np.int64, buffer)
        self._head = np.ndarray((slots, 2), np.uint32, buffer, 8)
        self._text: NDArray[np.uint8] = np.ndarray((slots, self._room), np.uint8, buffer, 8 + slots * _HEAD)
        self._seen = 0

    @staticmethod
    def size(slots: int, n_bytes: int) -> int:
        """Bytes that a lane takes."""
        return 8 + slots * n_bytes

    def put(self, message: Mapping[str, Any]) -> bool:
        """Put a message on the lane; False for one that is too long, which is left out."""
        packed = json.dumps(message, separators=(",", ":"), ensure_ascii=False)
        text = np.frombuffer(packed.encode(errors="replace"), np.uint8)
        if len(text) > self._room:
            return False
        slot = int(self._put[0]) % self._slots
        # invalid while it is written: a reader in between finds no message, never half of one
        self._head[slot] = 0, 0
        self._text[slot, : len(text)] = text
        self._head[slot] = len(text), crc32(text)
        self._put[0] += 1
        return True

    def read(self) -> tuple[list[Message], int]:
        """Messages since the last call, oldest first, and how many were overwritten unread."""
        put, messages = int(self._put[0]), []
        first = max(self._seen, put - self._slots + 1)
        missed = first - self._seen
        for i in range(first, put):
            slot = i % self._slots
            n, crc = (int(x) for x in self._head[slot])
            text = self._text[slot, : min(n, self._room)].copy()
            if n == 0 or crc32(text) != crc:
                missed += 1  # overwritten meanwhile
                continue
            messages.append(json.loads(text.tobytes()))
        self._seen = put
        return messages, missed

    def release(self) -> None:
        """Let go of the memory."""
        self._put = self._head = self._text = np.zeros(0, np.uint8)


class Board:
    """Shared memory of a run and its page (or `OSError`): the board ``name``, or a new one that ends with its maker."""

    def __init__(self, name: str | None = None) -> None:
        self._owner = name is None
        events = Lane.size(EVENT_SLOTS, EVENT_BYTES)
        self._memory = shared_memory(name, events + Lane.size(COMMAND_SLOTS, COMMAND_BYTES))
        buffer: Any = self._memory.buf
        self.events = Lane(buffer, EVENT_SLOTS, EVENT_BYTES)
        self.commands = Lane(buffer[events:], COMMAND_SLOTS, COMMAND_BYTES)

    @property
    def name(self) -> str:
        """By which the other side attaches."""
        return self._memory.name

    def close(self, *, leave: bool = False) -> None:
        """Let go of the memory; its maker also frees it, but for ``leave``: then it goes with the last process."""
        self.events.release()
        self.commands.release()
        with contextlib.suppress(BufferError):  # a view of it is still being read; freed with the process
            self._memory.close()
        if self._owner and not leave:
            self._owner = False
            with contextlib.suppress(FileNotFoundError):  # already gone
                self._memory.unlink()


PAGE = "page"
STATE_S = 0.05
STOPS = {
    "finish": (Stop.FINISH_STEP, "page: step finished"), "ramp_down": (Stop.RAMP_DOWN, "page: ramped down"),
    "now": (Stop.NOW, "page: stopped now"),
}  # fmt: skip


class WatchedRecorder(RecorderProcess):
    """A recorder whose frames and steps others can watch; as `RecorderProcess` in all else."""

    def __init__(self, path: Path | str, setup: Setup, board: Board, **options: Any) -> None:
        super().__init__(path, setup, private=False, **options)
        self._board = board

    def mark_step(self, step: np.void | Mapping[str, Any]) -> None:
        """As `RecorderProcess.mark_step`; the row goes on the board too."""
        super().mark_step(step)
        names = step.dtype.names or () if isinstance(step, np.void) else tuple(step)
        self._board.events.put({"kind": "step", **json_object({name: step[name] for name in names})})


class RunSide:
    """Events out and commands in, for one run (`bench.jobs.run_ramp.Onlooker`); ``also`` is called after each block."""

    def __init__(self, board: Board, also: Callable[[Status], None] | None = None, clock: Clock = SYSTEM) -> None:
        self._board, self._also, self._clock = board, also, clock
        self._request = StopRequest()
        self._progress: Callable[[Status], None] = lambda status: None
        self._sent_at = -math.inf
        self._sent: tuple[object, ...] = ()
        self._announced: Message = {}

    def recorder(self, path: Path, setup: Setup, **options: Any) -> RecorderProcess:
        """The recorder of a run that is watched."""
        return WatchedRecorder(path, setup, self._board, **options)

    def begin(
        self, recorder: RecorderProcess, backend: Backend, request: StopRequest, progress: Callable[[Status], None]
    ) -> Callable[[Status], None]:
        """Announce the run and where its frames are; returns what is called after each block, ``progress`` included."""
        self._request, self._progress = request, progress
        ring = recorder.ring
        self._announced = {
            "kind": "run",
            "out": str(recorder.path.absolute()),
            "backend": backend.name,
            "simulated": backend.simulated,
            "channels": list(backend.channels),
            "scales": {name: list(scale) for name, scale in backend.scales.items()},
            "ring": [ring.slots, ring.block_samples, ring.channels, ring.name],
            "leads": request.leads,
        }
        self._board.events.put(self._announced)
        return self._after_block

    def _after_block(self, status: Status) -> None:
        """Take commands, send the state of the run where it is due or another one, draw."""
        for command in self._board.commands.read()[0]:
            self._obey(command)
        now = self._clock.monotonic_s()
        state = (status.state, status.step.index, self._request.pause, self._request.wanted)
        # twenty states a second at most: a simulation's blocks come far faster than a page shows them
        if now - self._sent_at >= STATE_S or state != self._sent:
            # due at even times: counted from the last one, a state would come with every sixth block, 17 a second
            self._sent_at, self._sent = max(self._sent_at + STATE_S, now - STATE_S), state
            self._board.events.put(state_of(status, self._request))
        if self._also is not None:
            self._also(status)
        self._progress(status)

    def end(self, summary: RunSummary | None, fault: str = "") -> None:
        """Send how the run ended; without a summary ``fault`` says why it has none."""
        ended: Message = {"kind": "ended", "how": "failed", "why": fault, "n_samples": 0}
        if summary is not None:
            names = ("how", "why", "n_samples", "steps_driven", "lost_samples")
            ended |= {name: getattr(summary, name) for name in names}
        self._board.events.put(ended)

    def _obey(self, command: Message) -> None:
        """Do what the page asks; what is not known is passed over."""
        wanted, text, request = command.get("do"), str(command.get("text", "")), self._request
        if wanted == "announce":  # a page that came late: what was said first may be overwritten
            self._board.events.put(self._announced)
            return
        if wanted in STOPS:
            request.ask(*STOPS[wanted])
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


def state_of(status: Status, request: StopRequest) -> Message:
    """A run's state as an event; null for what is not known."""
    same = (
        "n_steps", "sample", "n_samples", "left_samples", "achieved_gamma", "achieved_gamma_uncertainty", "plate_mps2",
        "lost_samples",
    )  # fmt: skip
    return {
        "kind": "state",
        "state": status.state.value,
        "step": status.step.index,
        "gamma": status.step.gamma,
        "step_first": status.step.first_sample,
        "step_end": status.step.end_sample,
        **json_object({name: getattr(status, name) for name in same}),
        "limits": {name: round(float(part), 4) for name, part in status.limits_in_use.items()},
        "contact_age_cycles": round(float(status.contact_age_cycles), 2),
        "pausing": request.pause,
        "stopping": None if request.wanted is None else request.wanted.name.lower(),
    }
