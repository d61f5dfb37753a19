"""The recorder's process on the simulated bench: its iterator, its pipe, and its death."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from benchmarks.bench_simulation.world import Killed, World
from daq.recorder.recorder_process import Order, recording


class RecorderOnBench:
    """The recorder's process and its pipe, as turns of its iterator."""

    def __init__(self, world: World, turn_ns: int) -> None:
        self._world, self._turn_ns = world, turn_ns
        self._to_run: deque[Any] = deque()
        self._to_recorder: deque[Any] = deque()
        self.is_dead = self.ended = self.run_is_gone = False
        self.stalls_ns = 0
        self.after_turn: Callable[[], None] = lambda: None
        self.after_mark: Callable[[], None] = lambda: None
        self.marked = False
        self._turns: Iterator[None] = iter(())

    def start(self, order: Order) -> tuple[RecorderOnBench, RecorderOnBench]:
        """As `daq.recorder.recorder_process.spawn`."""
        self._turns = recording(_End(self), order, self._world)
        self._world.at(0, self._turn)
        return self, self

    def _turn(self) -> None:
        if self.is_dead:
            return
        stalled, self.stalls_ns = self.stalls_ns, 0
        if stalled:
            self._world.at(self._world.now_ns + stalled, self._turn)
            return
        try:
            next(self._turns)
        except StopIteration:
            self.ended = True
        except Exception:
            # the disk refuses all that a killed process still does: only of a living one is an error a finding
            if not self.is_dead:
                raise
        if not self.is_dead:
            self.after_turn()
            if self.marked:
                self.after_mark()
        self.marked = False
        if not self.ended:
            self._world.at(self._world.now_ns + self._turn_ns, self._turn)

    def abandon(self) -> None:
        """Let go of what a dead process held."""
        if isinstance(self._turns, Iterator) and hasattr(self._turns, "close"):
            self._turns.close()

    # the run's end of the pipe, and its view of the process
    def send(self, obj: Any) -> None:
        """A word to the recorder."""
        if self.is_dead or self.ended or self._world.run_is_dead:
            raise BrokenPipeError(32, "Broken pipe")
        self._to_recorder.append(obj)

    def recv(self) -> Any:
        """A word from the recorder."""
        if not self._to_run:
            raise EOFError
        return self._to_run.popleft()

    def poll(self, timeout: float = 0.0) -> bool:
        """Whether there is one, or no process to send any."""
        gone = self.is_dead or self.ended
        return gone or self._world.until(lambda: bool(self._to_run or self.is_dead or self.ended), round(timeout * 1e9))

    def is_alive(self) -> bool:
        """Whether the process is there."""
        return not (self.is_dead or self.ended)

    def join(self, timeout: float | None = None) -> None:
        """Wait for its end."""
        with contextlib.suppress(Killed):
            self._world.until(lambda: not self.is_alive(), round((timeout or 0.0) * 1e9))


class _End:
    """The recorder's end of the pipe."""

    def __init__(self, of: RecorderOnBench) -> None:
        self._of = of

    def send(self, obj: Any) -> None:
        if self._of.run_is_gone:
            raise BrokenPipeError(32, "Broken pipe")
        self._of._to_run.append(obj)

    def recv(self) -> Any:
        if not self._of._to_recorder:
            raise EOFError
        word = self._of._to_recorder.popleft()
        self._of.marked |= word[0] == "mark_step"
        return word

    def poll(self, timeout: float = 0.0) -> bool:
        return bool(self._of._to_recorder) or self._of.run_is_gone
