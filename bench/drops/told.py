"""What a browser is told of a drop test: its files with their impacts, the sentences, the curves, the same command."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from analysis.drop.corrections import Corrections
from analysis.drop.load import Path2D, events_in
from analysis.drop.times.one_ahead import Drop
from bench.jobs.drop_test import DropTest, Request
from daq.files.wav import is_wav, open_wav
from daq.setup.errors import InputError

Told = dict[str, Any]

_AROUND_S = 0.3  # shown before the first and after the last impact
_SAME_IMPACT_FRAMES = 2.5
_SAME_IMPACT_S = 1e-7


def told_of(done: DropTest) -> Told:
    """A drop test for the page.

    Parameters
    ----------
    done
        `bench.jobs.drop_test.measure`.
    """
    payload = done.outcome.payload
    files = [_file(done, number) for number in range(len(done.request.files))]
    model = next(one for one in payload["models"] if one["name"] == payload["best"])
    return {
        "kind": "result",
        "explained": payload["explained"],
        "chosen": payload["chosen"],
        "best": payload["best"],
        "parameters": model["parameters"],
        "sentences": list(done.outcome.sentences),
        "files": files,
        "plot": done.plot.as_json(),
        "is_path": payload["kind"] == "camera",
        "command": command_line(done.request),
    }


def refusal_of(request: Request, why: str, known: Any) -> Told:
    """A refusal, with the events that a person may still correct."""
    files = []
    for path, part in zip(request.files, request.corrected, strict=True):
        try:
            events = events_in(path, part, known).tolist()
        except InputError:
            events = []
        span = [max(events[0] - _AROUND_S, 0.0), events[-1] + _AROUND_S] if events else [0.0, 1.0]
        files.append(_marks(path, part, span) | {"events": events})
    return {"kind": "refused", "why": why, "files": files, "command": command_line(request)}


def _marks(path: Path, part: Corrections, span: Sequence[float]) -> Told:
    return {
        "name": path.name,
        "kind": "sound" if is_wav(path) else "times",
        "impacts": [], "missed": [], "false": [], "events": [],
        "ignored": list(part.ignore_s), "added": list(part.add_s),
        "span": list(span), "same_s": _SAME_IMPACT_S, "seconds": True, "picture": False,
        "duration_s": _duration_s(path) or span[1],
    }  # fmt: skip


def _duration_s(path: Path) -> float | None:
    if not is_wav(path):
        return None
    wav = open_wav(path)
    return wav.n_samples / wav.rate_hz


def _file(done: DropTest, number: int) -> Told:
    """One file: its impacts and what else stands in it, in the file's own time."""
    path, part = done.request.files[number], done.request.corrected[number]
    own = [item for n, item in done.items if n == number]
    drops = [item for item in own if isinstance(item, Drop)]
    if not drops:
        return _path(done, number, next(item for item in own if isinstance(item, Path2D)))
    impacts = [
        {"t": float(t), "how": "irregular" if broken else "impact", "drop": k}
        for k, drop in enumerate(drops)
        for t, broken in zip(drop.bounces.impacts_s, drop.bounces.broken, strict=True)
    ]
    first, last = (float(drops[k].bounces.impacts_s[k]) for k in (0, -1))
    told = _marks(path, part, [max(first - _AROUND_S, 0.0), last + _AROUND_S])
    return told | {
        "impacts": impacts,
        "missed": [float(t) for drop in drops for t in drop.bounces.gaps_s],
        "false": [float(t) for drop in drops for t in drop.bounces.false_s],
        "events": drops[0].events_s.tolist(),
    }


def _path(done: DropTest, number: int, item: Path2D) -> Told:
    path, part = done.request.files[number], done.request.corrected[number]
    which = next(k for k, (_, one) in enumerate(done.items) if one is item)
    step = item.frame_s or 1.0
    times = item.clip.frame * step
    x, y = done.plot.data[done.plot.clips.index(which)]  # heights counted from the middle
    offset = float(item.clip.height[int(np.abs(times - x[0]).argmin())] - y[0])
    impacts = [
        {"t": t, "how": "impact" if both else "landing", "drop": 0}
        for clip, t, both in done.fitted_impacts_s
        if clip == which
    ]
    return _marks(path, part, [float(times[0]), float(times[-1])]) | {
        "kind": "path",
        "impacts": impacts,
        "seconds": item.frame_s is not None,
        "same_s": _SAME_IMPACT_FRAMES * step,
        "duration_s": float(times[-1]),
        "track": {"x": times.tolist(), "y": (item.clip.height - offset).tolist()},
        "item": which,
        "picture": item.tracked is not None,
    }


def command_line(request: Request) -> str | None:
    """The command that gives the same; None where corrections differ from file to file, which no command can say."""
    if len(set(request.corrected)) > 1:
        return None
    part = request.corrected[0]
    words = ["bench", "drop", *map(str, request.files)]
    named = (
        ("--fps", request.fps), ("--scale", request.scale_m), ("--ball-size", request.ball_size_m),
        ("--mass", request.mass_kg), ("--diameter", request.diameter_m), ("--from", part.from_s),
        ("--until", part.until_s), ("--axis", part.axis_deg),
    )  # fmt: skip
    for name, value in named:
        words += [name, f"{value:.9g}"] if value is not None else []
    if request.gravity_mps2 != Request.gravity_mps2:
        words += ["--gravity", f"{request.gravity_mps2:.9g}"]
    for name, values in (("--drop-height", request.heights_m), ("--ignore", part.ignore_s), ("--add", part.add_s)):
        for value in values:
            words += [name, f"{value:.9g}"]
    if part.region is not None:
        words += ["--region", ",".join(map(str, part.region))]
    return shlex.join(words)
