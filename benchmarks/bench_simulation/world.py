"""Virtual time: events in order, and all that waits moves them on; who is alive in it."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from daq.setup.clock import Clock

POLL_NS = 50_000_000  # a thread that waits for a port looks again after


class Killed(BaseException):
    """This process is gone; what is left of it must not act."""


class Stuck(AssertionError):
    """Something waits for ever."""


class World(Clock):
    """The clock of everything in a simulation.

    Parameters
    ----------
    begin_ns
        What the monotonic clock shows at the start.
    wall_ns
        What the wall clock shows then.
    drift
        By what part the computer's clocks run fast against true time.
    """

    def __init__(self, begin_ns: int, wall_ns: int, drift: float = 0.0) -> None:
        self._begin_ns, self.wall_ns, self._drift = begin_ns, wall_ns, drift
        self.now_ns = 0  # true time
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._n = 0
        self.most_events, self.latest_ns = 400_000, 10**18
        self.run_is_dead = False

    def at(self, ns: int, event: Callable[[], None]) -> None:
        """Let something happen at a true time, or as soon as can be."""
        self._n += 1
        heapq.heappush(self._events, (max(ns, self.now_ns), self._n, event))

    def _next(self, until_ns: int) -> bool:
        """Let the next event happen, if there is one by then."""
        if self.run_is_dead:
            raise Killed
        if not self._events or self._events[0][0] > until_ns:
            return False
        ns, _, event = heapq.heappop(self._events)
        self.now_ns = max(self.now_ns, ns)
        self.most_events -= 1
        if self.most_events < 0 or self.now_ns > self.latest_ns:
            raise Stuck(f"no end after {self.now_ns * 1e-9:.0f} s")
        event()
        return True

    def advance(self, ns: int) -> None:
        """Let time pass."""
        until = self.now_ns + ns
        while self._next(until):
            pass
        self.now_ns = max(self.now_ns, until)

    def until(self, ready: Callable[[], bool], ns: int) -> bool:
        """Let time pass until something is so, no longer than ``ns``."""
        until = self.now_ns + ns
        while not ready():
            if not self._next(until):
                self.now_ns = until
                return ready()
        return True

    def settle(self, over: Callable[[], bool], ns: int) -> None:
        """What goes on after the run's process has ended, until ``over``, no longer than ``ns``."""
        self.run_is_dead = False
        self.until(over, ns)

    def monotonic_ns(self) -> int:
        return self._begin_ns + round(self.now_ns * (1.0 + self._drift))

    def unix_ns(self) -> int:
        return self.wall_ns + self.now_ns

    def sleep(self, seconds: float) -> None:
        self.advance(max(1, round(seconds * 1e9)))

    def wait(self, changed: Any, seconds: float) -> bool:
        is_set: Callable[[], bool] | None = getattr(changed, "is_set", None)
        ns = max(1, round(seconds * 1e9))
        if is_set is not None:
            return self.until(is_set, ns)
        happened = self._next(self.now_ns + ns)  # of a condition: whoever waits looks again
        if not happened:
            self.now_ns += ns
        return happened

    def executor(self, name: str) -> Executor:
        return Late(self)

    def background(self, body: Iterator[None], name: str) -> Body:
        return Body(self, body)


class Body:
    """A thread, as turns of its iterator."""

    def __init__(self, world: World, body: Iterator[None]) -> None:
        self._world, self._body, self.ended = world, body, False
        world.at(world.now_ns, self._turn)

    def _turn(self) -> None:
        try:
            next(self._body)
        except StopIteration:
            self.ended = True
            return
        self._world.at(self._world.now_ns + POLL_NS, self._turn)

    def join(self, timeout: float) -> None:
        """Wait for its end."""
        self._world.until(lambda: self.ended, round(timeout * 1e9))


class Late(Executor):
    """A thread whose answers come some time later."""

    late_ns = 20_000_000

    def __init__(self, world: World) -> None:
        self._world = world

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Work that is done when its time is over."""
        answer = LateAnswer(self._world)
        value = fn(*args, **kwargs)
        self._world.at(self._world.now_ns + self.late_ns, lambda: answer.set_result(value))
        return answer

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """There is nothing to end."""


class LateAnswer(Future[Any]):
    """An answer for which virtual time is waited."""

    def __init__(self, world: World) -> None:
        super().__init__()
        self._world = world

    def result(self, timeout: float | None = None) -> Any:
        """The answer, once it is there."""
        self._world.until(self.done, 10**12)
        return super().result(0)
