"""The improved model as a profile: what was found is declared, with value, uncertainty and the recording it is from.

Every line of the recording's profile stays. What is not believed, belongs to one run or has no name is not declared:
it stands in comments at the end.
"""

from __future__ import annotations

import datetime
from pathlib import Path

from analysis.loop.result import ClosedLoop
from bench.profiles.edit import declare
from bench.profiles.next_run import profile_text
from daq.files.whole_file import write_whole
from daq.setup.errors import InputError
from daq.setup.values import MeasuredValue


def write_improved(loop: ClosedLoop, recording: Path, path: Path, text: str | None = None) -> list[str]:
    """Write the profile of ``recording`` with the effects of ``loop`` declared in it to the new file ``path``.

    A loop whose verdict is "unexplained" declares nothing; its effects are written as comments, ready to be declared by
    whoever believes them.

    Raises `InputError` when the recording holds no profile. Returns what was written, and what was found and is not
    declared, a line each.

    Parameters
    ----------
    loop, recording
        The closed loop and the first of its recordings.
    path
        The new file.
    text
        The profile by which the loop was closed, where that is not the recording's own.
    """
    text = profile_text(recording) if text is None else text
    if not text.strip():
        raise InputError(f"{recording}: holds no profile to improve; import it again with --profile")
    on, source = datetime.date.today(), f"closed loop on {recording.name}"
    found = [
        MeasuredValue(f"declared.{p.effect}.{p.parameter}", p.value, p.sigma, source)
        for p in loop.selection.added
        if not p.trend
    ]
    believed = loop.verdict != "unexplained"
    edited = declare(text, found if believed else [], on, str(path))
    doubtful = [] if believed else found
    left = not_declared(loop)
    comments = [f"not declared: {words}" for words in left]
    if doubtful:
        comments += [
            "not declared, because the verdict was unexplained: the best that was found, which leaves something over.",
            "Take the marks off the lines below to declare it all the same.",
            *declare("", doubtful, on, str(path)).split("\n")[:-1],
        ]
    if comments and not edited.endswith("\n"):
        edited += "\n"
    write_whole(path, edited + "".join(f"# {line}".rstrip() + "\n" for line in comments))
    if not found and not left:
        return [f"improved profile: {path} (unchanged: nothing was found to declare)"]
    refused = [f"{m.key.removeprefix('declared.')} = {m.value:.4g}: the verdict is unexplained" for m in doubtful]
    return [f"improved profile: {path}", *(f"  not declared in it: {words}" for words in (*refused, *left))]


def not_declared(loop: ClosedLoop) -> list[str]:
    """What was found and no profile can hold: a trend during the run, and a term without a name."""
    middle = "" if loop.verdict == "unexplained" else "; its middle is declared"
    left = [
        f"{p.effect}.{p.parameter} changed by {p.value:.3g} from start to end of this run{middle}"
        for p in loop.selection.added
        if p.trend
    ]
    if loop.discovered is not None:
        left.append(f"{loop.discovered.description} (discovered, without a name)")
    return left
