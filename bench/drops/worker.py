"""The process that measures drops for the page, and the data that it gives to the page."""

from __future__ import annotations

import contextlib
import os
import shlex
import tempfile
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from analysis.drop.corrections import NOTHING, Corrections
from analysis.drop.figures import draw_track
from analysis.drop.load import Known, Path2D, events_in
from analysis.drop.times.model_fit import Drop
from bench.jobs.drop_test import MARKS, NUMBERS, DropTest, Request, check_request, measure, numbers_of
from bench.terminal.run_console import leave_keys_to_the_parent
from daq.files.wav import is_wav, open_wav
from daq.setup.errors import InputError

Message = dict[str, Any]


def result_of(done: DropTest) -> Message:
    """A drop test that was measured."""
    payload = done.outcome.payload
    model = next(one for one in payload["models"] if one["name"] == payload["best"])
    return {
        "kind": "result",
        **{key: payload[key] for key in ("explained", "chosen", "best")},
        "parameters": model["parameters"],
        "sentences": list(done.outcome.sentences),
        "files": [_file(done, number) for number in range(len(done.request.files))],
        "plot": done.plot.as_json(),
        "is_path": payload["kind"] == "camera",
        "command": command_line(done.request),
    }


def refusal_of(request: Request, why: str, known: Known) -> Message:
    """A refusal, with the events that a person may still correct."""
    files = []
    for path, part in zip(request.files, request.corrected, strict=True):
        try:
            events = events_in(path, part, known).tolist()
        except InputError:
            events = []
        files.append(_marks(path, part, [events[0], events[-1]] if events else None) | {"events": events})
    return {"kind": "refused", "why": why, "files": files, "command": command_line(request)}


def _marks(path: Path, part: Corrections, ends: Sequence[float] | None) -> Message:
    """A file without its impacts; ``ends``: times of the first and the last, where known."""
    try:
        wav = open_wav(path) if is_wav(path) else None
    except InputError:  # damaged: there is no sound to show
        wav = None
    # 0.3 s are shown before the first and after the last impact
    span = [0.0, 1.0] if ends is None else [max(ends[0] - 0.3, 0.0), ends[1] + 0.3]
    return {
        "name": path.name,
        "kind": "times" if wav is None else "sound",
        "impacts": [], "missed": [], "false": [], "events": [],
        "ignored": list(part.ignore_s), "added": list(part.add_s),
        "span": span, "same_s": 1e-7, "seconds": True, "picture": False,
        "duration_s": (wav.n_samples / wav.rate_hz if wav is not None else 0.0) or span[1],
    }  # fmt: skip


def _file(done: DropTest, number: int) -> Message:
    """One file: its impacts and what else stands in it, in the file's own time."""
    path, part = done.request.files[number], done.request.corrected[number]
    own = [(which, item) for which, (n, item) in enumerate(done.items) if n == number]
    drops = [item for _, item in own if isinstance(item, Drop)]
    if not drops:
        which, item = next((which, item) for which, item in own if isinstance(item, Path2D))
        return _marks(path, part, None) | _path(done, which, item)
    impacts = [
        {"t": float(t), "how": "irregular" if broken else "impact", "drop": k}
        for k, drop in enumerate(drops)
        for t, broken in zip(drop.bounces.impacts_s, drop.bounces.broken, strict=True)
    ]
    ends = [float(drops[0].bounces.impacts_s[0]), float(drops[-1].bounces.impacts_s[-1])]
    return _marks(path, part, ends) | {
        "impacts": impacts,
        "missed": [float(t) for drop in drops for t in drop.bounces.gaps_s],
        "false": [float(t) for drop in drops for t in drop.bounces.false_s],
        "events": drops[0].events_s.tolist(),
    }


def _path(done: DropTest, which: int, item: Path2D) -> Message:
    """The ball's path, its heights counted from the middle as in the plot."""
    step = item.frame_s or 1.0
    times = item.clip.frame * step
    x, y = done.plot.data[done.plot.clips.index(which)]
    offset = float(item.clip.height[int(np.abs(times - x[0]).argmin())] - y[0])
    return {
        "kind": "path",
        "impacts": [
            {"t": t, "how": "impact" if both else "landing", "drop": 0}
            for clip, t, both in done.fitted_impacts_s
            if clip == which
        ],
        "seconds": item.frame_s is not None,
        "same_s": 2.5 * step,
        "span": [float(times[0]), float(times[-1])],
        "duration_s": float(times[-1]),
        "track": {"x": times.tolist(), "y": (item.clip.height - offset).tolist()},
        "item": which,
        "picture": item.tracked is not None,
    }


def command_line(request: Request) -> str | None:
    """The command that gives the same; None where corrections differ from file to file, which no command can say."""
    if len(set(request.corrected)) > 1:
        return None
    words = ["bench", "drop", *map(str, request.files)]
    for names, given, usual in ((NUMBERS, request, Request(())), (MARKS, request.corrected[0], NOTHING)):
        for name, option in names.items():
            if (value := getattr(given, name)) != getattr(usual, name):
                words += [word for number in numbers_of(value) for word in (f"--{option}", f"{number:.9g}")]
    if request.use_height != Request.use_height:
        words += ["--use-height", request.use_height]
    if (region := request.corrected[0].region) is not None:
        words += ["--region", ",".join(map(str, region))]
    if request.balls is not None:
        words += ["--balls", str(request.balls)]
    return shlex.join(words)


def work(pipe: Connection, gives_way: bool) -> None:
    """Measure every request that comes, until the pipe ends; ``gives_way``: a run on this machine goes first.

    Answers are ``("progress", what, done, total)``, and at the end ``("done", message, payload, pictures)``.
    """
    leave_keys_to_the_parent()
    if gives_way and hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(10)
    known = Known()
    with contextlib.suppress(EOFError, OSError):
        while True:
            request = pipe.recv()
            pipe.send(_measured(request, known, pipe))


def _measured(request: Request, known: Known, pipe: Connection) -> tuple[Any, ...]:
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
