"""The profile of the next run: the recording's own, with another ratio, other gammas or another order of steps.

The result is parsed and checked against the rig's limits; a design that a limit forbids is passed over.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

from analysis.loop.close_loop import FittedLoop
from analysis.loop.design import Design, Ranked, designs_for, rank
from analysis.loop.result import ClosedLoop
from bench.profiles.edit import with_values
from bench.profiles.plan import planned
from daq.files.whole_file import write_whole
from daq.recording import open_recording
from daq.setup.errors import InputError
from rig.profile import parse_profile

WHERE = "the recording's profile"


def profile_text(recording: Path) -> str:
    """The text of the profile with which a recording was made; empty where it holds none."""
    with open_recording(recording) as opened:
        return str(opened.attrs.get("profile_text", ""))


def profile_of(text: str, design: Design) -> str:
    """The profile ``text`` changed to make ``design``; raises `InputError` where it has no ramp."""
    found = tomllib.loads(text)
    if "ramp" not in found or "forcing" not in found:
        raise InputError(f"{WHERE} has no [ramp]: it cannot be turned into a next run; write one by hand")
    values = {
        "forcing.ratio": design.ratio,
        "ramp.gamma": [float(f"{gamma:.6g}") for gamma in design.gammas],
        "ramp.order": design.order,
    }
    return with_values(text, values, WHERE)


def possible_runs(loop: ClosedLoop, fitted: FittedLoop, recording: Path) -> list[Ranked]:
    """Ranked next runs that the rig's limits allow; every design where the recording's profile has no ramp."""
    text = profile_text(recording)
    allowed = []
    for design in designs_for(loop.steps.gamma, int(loop.steps.ratio[0])):
        try:
            profile = parse_profile(profile_of(text, design), "next run")
        except InputError:
            allowed.append(design)  # no limits to check against: the design is advice
            continue
        if not planned(profile)[2]:
            allowed.append(design)
    return rank(fitted, allowed)


def write_next(ranked: Sequence[Ranked], recording: Path, path: Path) -> None:
    """Write the profile of the best next run to the file ``path`` (raises `InputError`)."""
    write_whole(path, profile_of(profile_text(recording), ranked[0].design))
