"""`bench profile`: the profiles that are there, the text of one, and a new one to make yours."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from bench.outputs import JSON, PROFILE, File, Json, Overwrite, check_outputs
from bench.terminal.console import print_lines, print_table, write_json

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
    from bench.profiles.improved import text_of

    text = text_of(name)
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
    from bench.profiles.improved import new_profile

    check_outputs(File("PROFILE.toml", out, PROFILE), inputs=[like], overwrite=overwrite)
    text = new_profile(out.stem, like)
    out.write_text(text, encoding="utf-8")
    print_lines(f"{out}: like {like}; edit it, then: bench plan {out}")
