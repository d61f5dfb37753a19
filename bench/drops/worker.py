"""The process that measures for the page, so that the page answers meanwhile; it remembers what is slow to find."""

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


def work(pipe: Connection, gives_way: bool) -> None:
    """Measure every request that comes, until the pipe ends; ``gives_way``: a run on this machine goes first.

    Answers are ``("progress", what, done, total)``, and at the end ``("done", message, payload, pictures)``.
    """
    from analysis.drop.load import Known

    leave_keys_to_the_parent()
    if gives_way and hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(10)
    known = Known()
    with contextlib.suppress(EOFError, OSError):
        while True:
            request = pipe.recv()
            pipe.send(_measured(request, known, pipe))


def _measured(request: Any, known: Any, pipe: Connection) -> tuple[Any, ...]:
    from analysis.drop.figures import draw_track
    from bench.drops.page_data import refusal_of, result_of
    from bench.jobs.drop_test import check_request, measure

    sent_at = 0.0

    def progress(what: str, done: int, total: int) -> None:
        nonlocal sent_at
        if time.monotonic() - sent_at > 0.2:  # between two messages of progress
            sent_at = time.monotonic()
            pipe.send(("progress", what, done, total))

    try:
        check_request(request)
        done = measure(request, progress, known)
    except (InputError, OSError, MemoryError) as error:
        return "done", refusal_of(request, str(error) or type(error).__name__, known), None, {}
    pictures = {}  # the track over the film, PNG by number of the file
    with tempfile.TemporaryDirectory() as folder:
        for number, item in done.items:
            tracked = getattr(item, "tracked", None)
            if tracked is not None:
                pictures[number] = draw_track(tracked, item.name, Path(folder) / "track.png").read_bytes()
    return "done", result_of(done), done.outcome.payload, pictures
