"""A new profile from a shipped one, a file or a recording's, and the ramp of a shipped one put into it."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

from bench.profiles.edit import with_values
from bench.profiles.find import find_profile, load, shipped_names
from bench.profiles.next_run import profile_text
from daq.files.whole_file import write_whole
from daq.setup.errors import InputError
from daq.setup.strict_toml import read_toml_text
from rig.profile import parse_profile

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
    """The name in ``folder`` of the profile ``like``; one from elsewhere is written there, as `new_profile`, first.

    A new profile takes a free name, ``my-simulated.toml`` or ``my-simulated-2.toml``. Raises `InputError`, OSError.
    """
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
