"""Time, waiting and threads, as the machine has them: the seam at which a simulation takes their place.

What measures or waits is given a `Clock`; the default is the machine's. Decision 460.
"""

from __future__ import annotations

import collections
import datetime
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor


class Clock:
    """The machine's clocks and threads."""

    def monotonic_ns(self) -> int:
        """Nanoseconds that only grow."""
        return time.monotonic_ns()

    def monotonic_s(self) -> float:
        """The same in seconds."""
        return self.monotonic_ns() * 1e-9

    def unix_ns(self) -> int:
        """The wall clock, nanoseconds since 1970 (UTC)."""
        return time.time_ns()

    def sleep(self, seconds: float) -> None:
        """Do nothing for a while."""
        time.sleep(seconds)

    def wait(self, changed: threading.Event | threading.Condition, seconds: float) -> bool:
        """Wait for a change, no longer than ``seconds``; whether it came."""
        return changed.wait(seconds)

    def executor(self, name: str) -> Executor:
        """One thread that takes work in order."""
        return ThreadPoolExecutor(1, name)

    def background(self, body: Iterator[None], name: str) -> threading.Thread:
        """Run ``body``, which yields after each wait, to its end in a thread of its own."""
        # a deque that holds nothing takes all that an iterator gives
        thread = threading.Thread(target=collections.deque, args=(body, 0), name=name, daemon=True)
        thread.start()
        return thread


SYSTEM = Clock()


def now_utc(clock: Clock = SYSTEM) -> str:
    """The wall clock as ISO 8601 in UTC."""
    now = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC) + datetime.timedelta(microseconds=clock.unix_ns() // 1000)
    return now.isoformat(timespec="microseconds").removesuffix("+00:00") + "Z"
