"""A JACK server whose clients' callbacks run before all other work, for figures on a machine that has other work.

Nothing of the project changes; `bench virtual` and the rig find the server and use it. Linux, with
the rights for real-time scheduling.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

PLANT, RUN = 20, 10  # priorities: the plant before the run; the callbacks of both before these


@contextmanager
def server(name: str, rate_hz: int, period: int) -> Iterator[None]:
    """The server ``name`` with the dummy driver, as long as the block runs."""
    command = ["jackd", "-R", "-P", "40", "-n", name, "-d", "dummy", "-r", str(rate_hz), "-p", str(period)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(1.0)
    try:
        yield
    finally:
        process.terminate()
        process.wait(10.0)


def asked(first: bool, name: str, rate_hz: int, period: int) -> Any:
    """`server` where ``first``, else nothing."""
    return server(name, rate_hz, period) if first else nullcontext()


def before(priority: int) -> list[str]:
    """What stands before a command that is to run before all else."""
    return ["chrt", "-f", str(priority)]


def this_process(priority: int) -> None:
    """Run this process, and what it starts, before all else."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
