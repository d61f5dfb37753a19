"""The improved model as a profile: what was found is declared, with value, uncertainty and the recording it is from.

Every line of the recording's profile is kept. What is not believed, belongs to one run or has no name is not declared:
it stands in comments at the end.
"""

from __future__ import annotations

import datetime
from pathlib import Path

from analysis.loop.close_loop import ClosedLoop
from analysis.residuals.forward_model import DRIFT
from bench.profiles.declare import Measured, declare
from daq.recording import open_recording
from daq.setup.errors import InputError


def write_improved(loop: ClosedLoop, recording: Path, path: Path, text: str | None = None) -> list[str]:
    """Write the profile of ``recording`` with the effects of ``loop`` declared in it to the new file ``path``.

    A loop whose verdict is "unexplained" declares nothing; its effects are written as comments, ready to be declared by
    whoever believes them.

    Parameters
    ----------
    loop, recording
        The closed loop and the first of its recordings.
    path
        The new file.
    text
        The profile by which the loop was closed, where that is not the recording's own.

    Returns
    -------
    list of str
        What was written, and what was found and is not declared, a line each.

    Raises
    ------
    InputError
        When the recording holds no profile.
    """
    if text is None:
        with open_recording(recording) as opened:
            text = str(opened.attrs.get("profile_text", ""))
    if not text.strip():
        raise InputError(f"{recording}: holds no profile to improve; import it again with --profile")
    fitted, on = loop.best.fitted, datetime.date.today()
    found = [
        Measured(
            name, q, float(fitted.values[name, q]), float(fitted.sigma((name, q))), f"closed loop on {recording.name}"
        )
        for name, q in loop.best.free
        if not q.endswith(DRIFT)
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
    path.write_text(edited + "".join(f"# {line}".rstrip() + "\n" for line in comments), encoding="utf-8")
    if not found and not left:
        return [f"improved profile: {path} (unchanged: nothing was found to declare)"]
    refused = [f"{m.effect}.{m.parameter} = {m.value:.4g}: the verdict is unexplained" for m in doubtful]
    return [f"improved profile: {path}", *(f"  not declared in it: {words}" for words in (*refused, *left))]


def not_declared(loop: ClosedLoop) -> list[str]:
    """What was found and no profile can hold: a trend during the run, and a term without a name."""
    left = []
    for name, q in loop.best.free:
        if q.endswith(DRIFT):
            bare, change = q.removesuffix(DRIFT), loop.best.fitted.values[name, q]
            middle = "" if loop.verdict == "unexplained" else "; its middle is declared"
            left.append(f"{name}.{bare} changed by {change:.3g} from start to end of this run{middle}")
    if loop.discovered is not None:
        left.append(f"{loop.discovered.in_words} (discovered, without a name)")
    return left
