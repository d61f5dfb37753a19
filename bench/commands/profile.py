"""`bench profile` and `bench plan`: profiles listed, shown and made; every step of a ramp before anything moves."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.table import Table

from bench.outputs import JSON, PROFILE, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_USAGE, GAMMA, fail, new_table, print_lines, print_table, write_json

if TYPE_CHECKING:
    from rig.programme.ramp import Peaks, Programme, Step

MOST_ROWS = 1000
"""Rows of the table; of a longer ramp its first and last half as many."""

app = typer.Typer(add_completion=False, rich_markup_mode=None, no_args_is_help=True, help="List, show, make profiles.")


@app.command("list")
def list_profiles(json: Json = None, overwrite: Overwrite = False) -> None:
    """List the shipped profiles, and the scenarios that a simulated rig can hide.

    Example: bench profile list
    """
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


def plan(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Print every step of a profile's ramp, and refuse (exit 2) what a limit forbids.

    Example: bench plan simulated
    """
    from bench.profiles.find import load, planned, refusal

    check_outputs(File("--json", json, JSON), inputs=[profile], overwrite=overwrite)
    checked, _ = load(profile)
    programme, rows, faults = planned(checked)
    answer = {
        "profile": checked.name,
        "frequency_hz": checked.forcing.frequency_hz,
        "tone_ratio": checked.forcing.ratio,
        "rate_hz": programme.rate_hz,
        "n_samples": programme.n_samples,
        "seconds": programme.n_samples / programme.rate_hz,
        "steps": [
            asdict(step) | asdict(asked) | {"seconds": step.n_samples / programme.rate_hz} for step, asked in rows
        ],
        "forbidden": faults,
    }
    if write_json(answer, json):
        forcing = checked.forcing
        print_lines(f"{checked.name}: {forcing.frequency_hz:g} Hz, c = {forcing.ratio}; peaks from rest")
        _print_plan(programme, rows)
        if (stake := checked.stake) is not None:
            print_lines(f"{' + '.join(stake.named)} is staked on it: bench stake holds the run against its prediction")
    if faults:
        fail(refusal(profile, faults), EXIT_USAGE)


def _print_plan(programme: Programme, rows: list[tuple[Step, Peaks]]) -> None:
    """The table for a person, and the length of the run: where that is long in hours or days, too."""
    rate_hz, half = programme.rate_hz, MOST_ROWS // 2
    table = new_table(
        "step", "gamma", "gamma\npeak", "drive\n(V)", "accel\n(m/s^2)", "speed\n(m/s)", "displ\n(mm)", "start\n(s)",
        "length\n(s)",
    )  # fmt: skip
    left_out = max(0, len(rows) - MOST_ROWS)
    for step, asked in rows if not left_out else rows[:half] + rows[-half:]:
        table.add_row(
            str(step.index), f"{step.gamma:.5g}", f"{asked.gamma_peak:.5g}", f"{asked.drive_v:.4g}",
            f"{asked.acceleration_mps2:.4g}", f"{asked.velocity_mps:.4g}", f"{asked.displacement_m * 1e3:.4g}",
            f"{step.first_sample / rate_hz:.3f}", f"{step.n_samples / rate_hz:.3f}",
        )  # fmt: skip
    print_table(table)
    print_lines(GAMMA)
    if left_out:
        print_lines(f"{left_out} steps in the middle are not shown; --json FILE writes all of them")
    seconds, longer = programme.n_samples / rate_hz, ""
    if seconds >= 7200.0:
        longer = f" ({seconds / 3600.0:.1f} hours)" if seconds < 172800.0 else f" ({seconds / 86400.0:.1f} days)"
    print_lines(f"{len(rows)} steps, {seconds:.1f} s{longer}, {programme.n_samples} samples at {rate_hz:g} Hz")
