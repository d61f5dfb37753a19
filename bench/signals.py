"""Ctrl-C and SIGTERM as wishes to stop, so that a run ends softly instead of where it happens to be.

The rule kept here: the first signal ramps down, the second is at zero now; the handlers that stood before come back.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rig.run import StopRequest
from rig.sequencer import Stop


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """A `StopRequest` that SIGINT and SIGTERM speak to while the block runs (main thread only)."""
    request = StopRequest()

    def handle(number: int, frame: FrameType | None) -> None:
        name = signal.Signals(number).name
        if request.wanted is None:
            request.ask(Stop.RAMP_DOWN, f"{name}: ramped down")
        else:
            request.ask(Stop.NOW, f"{name} again: stopped now")

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
