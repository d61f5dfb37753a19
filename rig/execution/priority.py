"""Before all other work: what drives a device asks the machine for that, where the machine can and may give it.

This is the one place that knows of POSIX's real-time scheduling. Where there is none (Windows,
macOS), or no right to it, everything runs as it did, and what comes too late is declared as always.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def before_other_work(priority: int = 10) -> Iterator[bool]:
    """While it lasts, this thread and what it starts run before all ordinary work; gives whether that was granted.

    A process that is already scheduled in real time (``chrt``) keeps what it was given.
    """
    if sys.platform != "linux" or os.sched_getscheduler(0) != os.SCHED_OTHER:
        yield False
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def may_run_first(priority: int) -> bool:
    """Whether this user may run a process before all others."""
    with before_other_work(priority) as granted:
        return granted or (sys.platform == "linux" and os.sched_getscheduler(0) != os.SCHED_OTHER)
