"""Profiles made from others: the improved model, the next run within the rig's limits, a new one from a shipped one."""

from __future__ import annotations

import datetime
import itertools
import re
import tomllib
from pathlib import Path

from analysis.loop.close_loop import FittedLoop
from analysis.loop.design import Design, Ranked, designs_for, rank
from analysis.loop.result import ClosedLoop
from bench.profiles.edit import declare, with_values
from bench.profiles.find import find_profile, load, planned, shipped_names
from daq.files.disk import write_whole
from daq.recording import open_recording
from daq.setup.errors import InputError
from daq.setup.values import MeasuredValue, read_toml_text
from rig.profile import parse_profile


def write_improved(loop: ClosedLoop, recording: Path, path: Path, text: str | None = None) -> list[str]:
    """Write the profile of ``recording`` with the effects of ``loop`` declared in it to the new file ``path``.

    A loop whose verdict is "unexplained" declares nothing; its effects are written as comments, ready to be declared by
    whoever believes them. Returns what was written, and what was found and is not declared, a line each.

    ``recording`` is the loop's first (`InputError`: without a profile); ``text`` is the profile by which the loop was
    closed, where that is not its own.
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
    # no profile can hold a trend during the run, nor a term without a name
    middle = "; its middle is declared" if believed else ""
    left = [
        f"{p.effect}.{p.parameter} changed by {p.value:.3g} from start to end of this run{middle}"
        for p in loop.selection.added
        if p.trend
    ]
    if loop.discovered is not None:
        left.append(f"{loop.discovered.description} (discovered, without a name)")
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


UNKNOWN_ZERO = (
    "# offset_v = 0.0       # reading at zero, unknown yet: bench calibrate accelerometer, or as bench import says"
)
OF_A_CARD = {
    "coupling": '"ac"         # capacitors in the inputs: contact is found by signed edges',
    "range_v": "2.0            # volts at the input's full scale: measure it, with the gain where it will stay",
    "open_v": "1.0             # in the air: divide the 5 V down into the card's range",
    "output_range_v": "1.4     # volts of that output at full scale: measure it",
}
"""What the inputs and the output of a card are like; the shipped profile is that of `bench virtual soundcard`."""

PRESETS = {
    "paper": "the paper's ramp, c = 1", "slow_sweep": "slow sweep, c = 1", "c2": "two tones, c = 2",
    "c3": "two tones, c = 3",
}  # fmt: skip
"""Shipped profiles whose forcing and ramp may be taken over, with a title."""


def new_profile(name: str, like: str) -> str:
    """Text of a profile ``name`` that is like a shipped one, a file or a recording's (raises `InputError`)."""
    text = with_values(text_of(like), {"name": name}, like)
    if not Path(like).is_file():  # the zero of a shipped profile's sensor is not this one's
        text = re.sub(r"(?m)^offset_v *=.*$", UNKNOWN_ZERO, text)
    if like == "soundcard":
        for key, value in OF_A_CARD.items():
            text = re.sub(rf"(?m)^{key} *=.*$", f"{key} = {value}", text)
    parse_profile(text, like)
    return text


def profile_in(folder: Path, like: str) -> str:
    """The name in ``folder`` of the profile ``like``; one from elsewhere is first written there, as `new_profile`."""
    given = find_profile(like).resolve()
    if like not in shipped_names() and given.parent == folder:
        return given.name
    stems = itertools.chain([f"my-{given.stem}"], (f"my-{given.stem}-{n}" for n in itertools.count(2)))
    stem = next(stem for stem in stems if not (folder / f"{stem}.toml").exists())
    write_whole(folder / f"{stem}.toml", new_profile(stem, like))
    return f"{stem}.toml"


def text_of(name: str) -> str:
    """The text of a profile, by shipped name, path, or recording (raises `InputError`)."""
    path = Path(name)
    if path.is_file() and path.suffix.lower() in (".h5", ".hdf5"):
        text = profile_text(path)
        if not text.strip():
            raise InputError(f"{path}: holds no profile")
        return text
    return read_toml_text(find_profile(name))


def with_preset(text: str, preset: str, where: str) -> str:
    """The profile ``text`` with forcing and ramp of one of `PRESETS`; raises `InputError` for another one."""
    if preset not in PRESETS:
        raise InputError(f"{preset}: no such preset; there are: {', '.join(PRESETS)}")
    shipped = load(preset)[0]
    values = {
        f"{table}.{key}": value
        for table in ("forcing", "ramp")
        for key, value in getattr(shipped, table).model_dump(exclude_none=True).items()
    }
    lists = {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
    return with_values(text, lists, where)
