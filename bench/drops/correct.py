"""A correction by hand on the page, and requests read back from the JSON of a result."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pydantic import TypeAdapter

from analysis.drop.corrections import Corrections
from bench.jobs.drop_test import Request
from daq.setup.errors import InputError

ENDING = ".drop.json"
_SAME_S = 1e-7


def moved(part: Corrections, gone_s: float | None, new_s: float | None, same_s: float = _SAME_S) -> Corrections:
    """``part`` with an impact taken away (``gone_s``), added (``new_s``) or, with both, moved.

    An added impact within ``same_s`` of ``gone_s`` is the one that is meant.
    """
    ignored, added = part.ignore_s, part.add_s
    if gone_s is not None:
        own = [t for t in added if abs(t - gone_s) <= same_s]
        if own:
            nearest = min(own, key=lambda t: abs(t - gone_s))
            added = tuple(t for t in added if t != nearest)
        else:
            ignored = (*ignored, gone_s)
    if new_s is not None:
        back = [t for t in ignored if abs(t - new_s) <= _SAME_S]
        if back:
            ignored = tuple(t for t in ignored if t not in back)
        else:
            added = (*added, round(new_s, 7))  # decimals of a second of a person's mark
    return replace(part, ignore_s=ignored, add_s=added)


def side_file(file: Path) -> Path:
    """The file next to a recording of a drop that has its result with all corrections."""
    return file.with_name(file.name + ENDING)


def saved_request(target: Path, files: Sequence[Path]) -> Request | None:
    """The request of the result in ``target``, on ``files``; None where there is none, or one of other files.

    Raises `InputError` where the file is there and is no result of a drop test.
    """
    try:
        text = target.read_text(encoding="utf-8")
    except OSError:
        return None
    try:
        saved = TypeAdapter(Request).validate_python(json.loads(text)["options"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{target}: wanted the result of a drop test as JSON; move it away or remove it") from error
    names = [file.name for file in files]
    if [file.name for file in saved.files] != names or len(saved.corrections) != len(names):
        return None
    return replace(saved, files=tuple(files))
