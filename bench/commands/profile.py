"""`bench profile`: the profiles that are there, the text of one, and a new one to make yours."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import typer

from bench.outputs import Overwrite

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
def list_profiles(
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The same for a machine; - prints it."),
    overwrite: Overwrite = False,
) -> None:
    """List the shipped profiles, and the scenarios that a simulated rig can hide.

    Example: bench profile list
    """
    from rich.table import Table

    from bench.outputs import JSON, File, check_or_leave
    from bench.profiles.find import load, scenario_names, shipped_folder, shipped_names
    from bench.terminal.console import print_lines, print_table, write_json

    check_or_leave(File("--json", json, JSON), overwrite=overwrite)
    rows: list[dict[str, Any]] = []
    for name in shipped_names():
        profile, _ = load(name)
        rows.append({
            "name": name, "backend": profile.backend.kind, "frequency_hz": profile.forcing.frequency_hz,
            "tone_ratio": profile.forcing.ratio, "description": profile.description,
        })  # fmt: skip
    write_json({"folder": shipped_folder(), "profiles": rows, "scenarios": scenario_names()}, json)
    if json == "-":
        return
    table = Table("name", "back end", "Hz", "c", "description", box=None, pad_edge=False)
    for row in rows:
        figures = (f"{row['frequency_hz']:g}", str(row["tone_ratio"]))
        table.add_row(row["name"], row["backend"], *figures, row["description"])
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
    import sys

    from bench.terminal.console import EXIT_USAGE, fail
    from daq.setup.errors import InputError

    try:
        text = _text_of(name)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
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
    from bench.outputs import PROFILE, File, check_outputs
    from bench.profiles.edit import with_values
    from bench.terminal.console import EXIT_USAGE, fail, print_lines
    from daq.setup.errors import InputError
    from rig.profile import parse_profile

    try:
        check_outputs(File("PROFILE.toml", out, PROFILE), inputs=[like], overwrite=overwrite)
        text = with_values(_text_of(like), {"name": out.stem}, like)
        if not Path(like).is_file():  # the zero of a shipped profile's sensor is not this one's
            text = re.sub(r"(?m)^offset_v *=.*$", UNKNOWN_ZERO, text)
        if like == "soundcard":
            for key, value in OF_A_CARD.items():
                text = re.sub(rf"(?m)^{key} *=.*$", f"{key} = {value}", text)
        parse_profile(text, like)
        out.write_text(text, encoding="utf-8")
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{out}: could not be written ({error.strerror})")
    print_lines(f"{out}: like {like}; edit it, then: bench plan {out}")


def _text_of(name: str) -> str:
    """The text of a profile, by shipped name, path, or recording (raises `InputError`)."""
    from bench.profiles.find import find_profile
    from bench.profiles.next_run import profile_text
    from daq.setup.errors import InputError
    from daq.setup.strict_toml import read_toml_text

    path = Path(name)
    if path.is_file() and path.suffix.lower() in (".h5", ".hdf5"):
        text = profile_text(path)
        if not text.strip():
            raise InputError(f"{path}: holds no profile")
        return text
    return read_toml_text(find_profile(name))
