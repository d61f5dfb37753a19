"""`bench profile`: the profiles that are there, the text of one, and a new one to make yours."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import typer

from bench.outputs import JSON, PROFILE, File, Json, Overwrite, check_outputs
from bench.terminal.console import print_lines, print_table, write_json
from daq.setup.errors import InputError

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

app = typer.Typer(add_completion=False, rich_markup_mode=None, no_args_is_help=True, help="List, show, make profiles.")


@app.command("list")
def list_profiles(json: Json = None, overwrite: Overwrite = False) -> None:
    """List the shipped profiles, and the scenarios that a simulated rig can hide.

    Example: bench profile list
    """
    from rich.table import Table

    from bench.profiles.find import load, scenario_names, shipped_folder, shipped_names

    check_outputs(File("--json", json, JSON), overwrite=overwrite)
    rows = [
        {
            "name": name, "backend": profile.backend.kind, "frequency_hz": profile.forcing.frequency_hz,
            "tone_ratio": profile.forcing.ratio, "description": profile.description,
        }
        for name, profile in ((name, load(name)[0]) for name in shipped_names())
    ]  # fmt: skip
    if not write_json({"folder": shipped_folder(), "profiles": rows, "scenarios": scenario_names()}, json):
        return
    table = Table("name", "back end", "Hz", "c", "description", box=None, pad_edge=False)
    for row in rows:
        table.add_row(*(f"{x:g}" if isinstance(x, float) else str(x) for x in row.values()))
    print_table(table)
    print_lines(f"scenarios: {', '.join(scenario_names())}")
    print_lines("make one yours: bench profile new my_rig.toml --like NAME")


@app.command("show")
def show(
    name: str = typer.Argument(metavar="NAME", help="A shipped profile, a profile's path, or a recording's."),
) -> None:
    """Print a profile's text: a shipped one's, a file's, or the one with which a recording was made.

    Example: bench profile show run.h5
    """
    text = _text_of(name)
    sys.stdout.write(text if text.endswith("\n") else text + "\n")


@app.command("new")
def new(
    out: Path = typer.Argument(metavar="PROFILE.toml", help="The file to make."),
    like: str = typer.Option("simulated", "--like", metavar="NAME", help="A shipped profile, a path, or a recording."),
    overwrite: Overwrite = False,
) -> None:
    """Make a profile of your own from a shipped one, another file, or a recording's; then edit and calibrate it.

    Example: bench profile new my_rig.toml --like soundcard
    """
    from bench.profiles.edit import with_values
    from rig.profile import parse_profile

    check_outputs(File("PROFILE.toml", out, PROFILE), inputs=[like], overwrite=overwrite)
    text = with_values(_text_of(like), {"name": out.stem}, like)
    if not Path(like).is_file():  # the zero of a shipped profile's sensor is not this one's
        text = re.sub(r"(?m)^offset_v *=.*$", UNKNOWN_ZERO, text)
    if like == "soundcard":
        for key, value in OF_A_CARD.items():
            text = re.sub(rf"(?m)^{key} *=.*$", f"{key} = {value}", text)
    parse_profile(text, like)
    out.write_text(text, encoding="utf-8")
    print_lines(f"{out}: like {like}; edit it, then: bench plan {out}")


def _text_of(name: str) -> str:
    """The text of a profile, by shipped name, path, or recording (raises `InputError`)."""
    from bench.profiles.find import find_profile
    from bench.profiles.next_run import profile_text
    from daq.setup.strict_toml import read_toml_text

    path = Path(name)
    if path.is_file() and path.suffix.lower() in (".h5", ".hdf5"):
        text = profile_text(path)
        if not text.strip():
            raise InputError(f"{path}: holds no profile")
        return text
    return read_toml_text(find_profile(name))
