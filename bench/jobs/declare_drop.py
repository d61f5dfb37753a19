"""The result of a drop test written into a rig profile, with its source, and nothing stale with it."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from daq.setup.errors import InputError

if TYPE_CHECKING:
    from analysis.drop.outcome import Outcome


def declare_into(profile: Path, outcome: Outcome, stale: str, ask: Callable[[str], bool | None]) -> str | None:
    """Write what was measured into a profile that still reads afterwards; returns why nothing was written.

    Parameters
    ----------
    profile
        The file.
    outcome
        What was measured; nothing that is unexplained, or compatible with zero, is in it.
    stale
        "keep" or "remove" effects that are declared and that this result was measured without; "ask" about them.
    ask
        Puts a question; None where there is no answer.

    Raises
    ------
    InputError
        The profile cannot be read, or would be none any more.
    """
    from bench.profiles.edit import declare, withdraw
    from daq.files.whole_file import write_whole
    from rig.profile import parse_profile

    if not outcome.measured:
        reasons = "; ".join(outcome.payload["unexplained_because"]) or "every value is compatible with zero"
        return f"{profile}: nothing was written into it: {reasons}"
    try:
        text = profile.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{profile}: cannot be read ({error.strerror})") from error
    before = parse_profile(text, str(profile)).declared
    effects = sorted({item.effect for item in outcome.measured})
    left = [name for name in ("coulomb_friction", "quadratic_drag") if name in before and name not in effects]
    if left and stale == "ask":
        names = " and ".join(left)
        answer = ask(f"{profile} declares {names}; the restitution was measured without. Remove it?")
        if answer is None:
            return (
                f"{profile}: nothing was written into it: it declares {names}, and the restitution found here was "
                "measured without; say --stale remove or --stale keep"
            )
        stale = "remove" if answer else "keep"
    edited = declare(text, outcome.measured, datetime.date.today(), str(profile))
    if left and stale == "remove":
        edited = withdraw(edited, left, str(profile))
        outcome.sentences.append(f"{profile}: removed {', '.join(left)}")
    parse_profile(edited, str(profile))
    write_whole(profile, edited)
    outcome.sentences.append(f"{profile}: declared {', '.join(effects)}")
    return None
