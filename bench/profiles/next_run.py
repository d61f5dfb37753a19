"""The profile of the next run: the recording's own, with another ratio, other gammas or another order of steps.

Only lines of ``[forcing]`` and ``[ramp]`` change, the result is parsed and checked against the
rig's limits, and a design that a limit forbids is passed over.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from analysis.loop.close_loop import FittedLoop
from analysis.loop.design import Design, Ranked, designs_for, rank
from analysis.loop.result import ClosedLoop
from daq.recording import open_recording
from daq.setup.errors import InputError
from rig.profile import parse_profile


def profile_text(recording: Path) -> str:
    """The text of the profile with which a recording was made; empty where it holds none."""
    with open_recording(recording) as opened:
        return str(opened.attrs.get("profile_text", ""))


def profile_of(text: str, design: Design) -> str:
    """The profile ``text`` changed to make ``design``.

    Raises
    ------
    InputError
        When the profile has no ramp, or cannot be edited line by line.
    """
    wanted = tomllib.loads(text)
    if "ramp" not in wanted or "forcing" not in wanted:
        raise InputError(
            "the recording's profile has no [ramp]: it cannot be turned into a next run; write one by hand"
        )
    changes = {
        ("forcing", "ratio"): str(design.ratio),
        ("ramp", "gamma"): "[" + ", ".join(f"{g:.6g}" for g in design.gammas) + "]",
        ("ramp", "order"): f'"{design.order}"',
    }
    lines = text.splitlines()
    for (section, key), value in changes.items():
        _put(lines, section, key, value)
    edited = "\n".join(lines) + "\n"
    try:
        found = tomllib.loads(edited)
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"the recording's profile cannot be edited line by line ({error}); write the next one by hand"
        ) from error
    if found["forcing"].get("ratio") != design.ratio or found["ramp"].get("order") != design.order:
        raise InputError("the recording's profile cannot be edited line by line; write the next one by hand")
    return edited


def _put(lines: list[str], section: str, key: str, value: str) -> None:
    """Set ``key`` in ``[section]``, in place."""
    start = next(i for i, line in enumerate(lines) if re.match(rf"\s*\[\s*{section}\s*\]", line))
    stop = next((i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("[")), len(lines))
    at = next((i for i in range(start + 1, stop) if re.match(rf"\s*{key}\s*=", lines[i])), None)
    if at is None:
        lines.insert(start + 1, f"{key} = {value}")
    else:
        lines[at] = f"{key} = {value}"


def possible_runs(loop: ClosedLoop, fitted: FittedLoop, recording: Path) -> list[Ranked]:
    """Ranked next runs that the rig's limits allow; every design where the recording's profile has no ramp."""
    from bench.commands.plan import planned

    text = profile_text(recording)
    allowed = []
    for design in designs_for(loop.steps.gamma, int(loop.steps.ratio[0])):
        try:
            profile = parse_profile(profile_of(text, design), "next run")
        except InputError:
            allowed.append(design)  # nothing to check it against: it is advice
            continue
        if not planned(profile)[2]:
            allowed.append(design)
    return rank(fitted, allowed)


def write_next(ranked: Sequence[Ranked], recording: Path, path: Path) -> None:
    """Write the profile of the best next run to the file ``path`` (raises `InputError`)."""
    path.write_text(profile_of(profile_text(recording), ranked[0].design), encoding="utf-8")
