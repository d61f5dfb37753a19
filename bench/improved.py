"""The improved model as a profile: what was found is declared, with value, uncertainty and the recording it is from.

The rule kept here: the profile of the recording, every line of it, plus the declarations; never written over a file.
"""

from __future__ import annotations

import datetime
from pathlib import Path

from analysis.close_loop import Loop
from analysis.drop.declare import Measured, declare
from analysis.likelihood import DRIFT
from daq.errors import InputError
from daq.recording import open_recording


def write_improved(loop: Loop, recording: Path, path: Path) -> None:
    """Write the profile of ``recording`` with the effects of ``loop`` declared in it to the new file ``path``.

    Raises
    ------
    InputError
        When ``path`` exists, or the recording holds no profile.
    """
    if path.exists():
        raise InputError(f"{path}: exists already; name a new file for the improved profile")
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
    path.write_text(declare(text, found, datetime.date.today(), str(path)), encoding="utf-8")
