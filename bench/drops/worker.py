"""The process that measures for the page, so that the page answers meanwhile; it keeps what is slow to find."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from bench.terminal.signals import leave_keys_to_the_parent
from daq.setup.errors import InputError

NICENESS = 10
_TOLD_EVERY_S = 0.2


def work(pipe: Connection, gives_way: bool) -> None:
    """Measure every request that comes, until the pipe ends; ``gives_way``: a run on this machine goes first.

    Answers are ``("progress", what, done, total)``, and at the end ``("told", told, payload, pictures)``.
    """
    from analysis.drop.load import Known

    leave_keys_to_the_parent()
    if gives_way and hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(NICENESS)
    known = Known()
    with contextlib.suppress(EOFError, OSError):
        while True:
            request = pipe.recv()
            pipe.send(_measured(request, known, pipe))


def _measured(request: Any, known: Any, pipe: Connection) -> tuple[Any, ...]:
    from bench.drops.told import refusal_of, told_of
    from bench.jobs.drop_test import check_request, measure

    told_at = 0.0

    def progress(what: str, done: int, total: int) -> None:
        nonlocal told_at
        if time.monotonic() - told_at > _TOLD_EVERY_S:
            told_at = time.monotonic()
            pipe.send(("progress", what, done, total))

    try:
        check_request(request)
        done = measure(request, progress, known)
    except (InputError, ValueError, OSError, MemoryError) as error:
        return "told", refusal_of(request, str(error) or type(error).__name__, known), None, {}
    return "told", told_of(done), done.outcome.payload, _pictures(done)


def _pictures(done: Any) -> dict[int, bytes]:
    """The track over the film, PNG by number of the file."""
    from analysis.drop.figures import draw_track

    made = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, item in done.items:
            if getattr(item, "tracked", None) is not None:
                made[number] = draw_track(item.tracked, item.clip.name, Path(folder) / "track.png").read_bytes()
    return made
