"""The improved model as a profile: what was found is declared, with value, uncertainty and the recording it is from.

The rule kept here: the profile of the recording, every line of it, plus the declarations; never written over a file.
What cannot be declared, because it belongs to one run or has no name, is said in a comment at the end.
"""

from __future__ import annotations

import datetime
from pathlib import Path

from analysis.close_loop import Loop
from analysis.drop.declare import Measured, declare
from analysis.likelihood import DRIFT
from daq.errors import InputError
from daq.recording import open_recording


def write_improved(loop: Loop, recording: Path, path: Path, text: str | None = None) -> list[str]:
    """Write the profile of ``recording`` with the effects of ``loop`` declared in it to the new file ``path``.

    ``text`` is the profile by which the loop was closed, where that is not the recording's own. Returns what was found
    and is not declared, in words.

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
    fitted = loop.best.fitted
    found = [
        Measured(
            name, q, float(fitted.values[name, q]), float(fitted.sigma((name, q))), f"closed loop on {recording.name}"
        )
        for name, q in loop.best.free
        if not q.endswith(DRIFT)
    ]
    left = not_declared(loop)
    edited = declare(text, found, datetime.date.today(), str(path))
    path.write_text(edited + "".join(f"# not declared: {words}\n" for words in left), encoding="utf-8")
    return left


def not_declared(loop: Loop) -> list[str]:
    """What was found and no profile can hold: a trend during the run, and a term without a name."""
    left = []
    for name, q in loop.best.free:
        if q.endswith(DRIFT):
            bare, change = q.removesuffix(DRIFT), loop.best.fitted.values[name, q]
            left.append(f"{name}.{bare} changed by {change:.3g} from start to end of this run; its middle is declared")
    if loop.discovered is not None:
        left.append(f"{loop.discovered.in_words} (discovered, without a name)")
    return left
