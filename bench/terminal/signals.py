"""Ctrl-C, Ctrl-\\, SIGTERM and a closed terminal (SIGHUP) as requests to stop a run softly.

The first signal ramps down, the second sets the drive to zero at once; the former handlers are restored.
A closing terminal may send SIGHUP several times: which never makes a soft stop a hard one.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from rig.execution.operator import StopRequest
from rig.programme.sequencer import Stop


def leave_keys_to_the_parent() -> None:
    """Ignore what the keys of a terminal send to all its processes: Ctrl-C, and Ctrl-\\ where there is SIGQUIT."""
    for name in ("SIGINT", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(signal.Signals[name], signal.SIG_IGN)


def spawned(
    body: Callable[..., None], *arguments: Any, name: str, daemon: bool = False
) -> tuple[Connection, BaseProcess]:
    """A started process that runs ``body`` on its end of a pipe and the arguments; our end, and the process.

    The body calls `leave_keys_to_the_parent` first. A daemon ends with this process.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=body, args=(theirs, *arguments), name=name, daemon=daemon)
    process.start()
    theirs.close()
    return ours, process


@contextmanager
def stop_on_signals(request: StopRequest | None = None) -> Iterator[StopRequest]:
    """A `StopRequest` that these signals set while the block runs; in the main thread only."""
    request = request or StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request  # Python delivers signals only to the main thread
        return
    asked: list[str] = []

    def handle(number: int, frame: FrameType | None) -> None:
        name = signal.Signals(number).name
        if name == "SIGHUP" or not asked:
            request.ask(Stop.RAMP_DOWN, f"{name}: ramped down")
        else:
            request.ask(Stop.NOW, f"{name} again: stopped now")
        if name != "SIGHUP":
            asked.append(name)

    # Windows has no SIGHUP and no SIGQUIT
    known = [signal.Signals[n] for n in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, n)]
    before = {number: signal.signal(number, handle) for number in known}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
