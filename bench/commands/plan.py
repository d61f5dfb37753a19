"""`bench plan`: every step of a ramp in figures, before anything moves; what a limit forbids is refused."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from rig.profile import Profile
    from rig.programme.ramp import Peaks, Programme, Step


def command(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The same for a machine; - prints it."),
    overwrite: Overwrite = False,
) -> None:
    """Print every step of a profile's ramp, and refuse (exit 2) what a limit forbids.

    Example: bench plan simulated
    """
    from bench.outputs import JSON, File, check_outputs
    from bench.profiles.find import load
    from bench.profiles.plan import planned, refusal
    from bench.terminal.console import EXIT_USAGE, fail, write_json
    from daq.setup.errors import InputError

    try:
        check_outputs(File("--json", json, JSON), inputs=[profile], overwrite=overwrite)
        checked, _ = load(profile)
        programme, rows, faults = planned(checked)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    write_json(as_json(checked, programme, rows, faults), json)
    if json != "-":
        _print(checked, programme, rows)
    if faults:
        fail(refusal(profile, faults), EXIT_USAGE)


def as_json(
    profile: Profile, programme: Programme, rows: list[tuple[Step, Peaks]], faults: list[str]
) -> dict[str, Any]:
    """The plan for a machine; the keys are the table's columns with their units."""
    return {
        "profile": profile.name,
        "frequency_hz": profile.forcing.frequency_hz,
        "tone_ratio": profile.forcing.ratio,
        "rate_hz": programme.rate_hz,
        "n_samples": programme.n_samples,
        "seconds": programme.n_samples / programme.rate_hz,
        "steps": [
            asdict(step) | asdict(asked) | {"seconds": step.n_samples / programme.rate_hz} for step, asked in rows
        ],
        "forbidden": faults,
    }


MOST_ROWS = 1000
"""Rows of the table; of a longer ramp its first and last half as many."""


def duration(seconds: float) -> str:
    """A run's length: in seconds, and where that is long in hours or days, too."""
    if seconds < 7200.0:
        return f"{seconds:.1f} s"
    longer = f"{seconds / 3600.0:.1f} hours" if seconds < 172800.0 else f"{seconds / 86400.0:.1f} days"
    return f"{seconds:.1f} s ({longer})"


def _print(profile: Profile, programme: Programme, rows: list[tuple[Step, Peaks]]) -> None:
    """The table for a person."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from bench.terminal.console import GAMMA, print_lines, print_table

    table = Table(box=SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    for heading in ("step", "gamma", "gamma\npeak", "drive\n(V)", "accel\n(m/s^2)", "speed\n(m/s)", "displ\n(mm)",
                    "start\n(s)", "length\n(s)"):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    left_out = max(0, len(rows) - MOST_ROWS)
    shown = rows if not left_out else rows[: MOST_ROWS // 2] + rows[-(MOST_ROWS // 2) :]
    for step, asked in shown:
        table.add_row(
            str(step.index), f"{step.gamma:.5g}", f"{asked.gamma_peak:.5g}", f"{asked.drive_v:.4g}",
            f"{asked.acceleration_mps2:.4g}", f"{asked.velocity_mps:.4g}", f"{asked.displacement_m * 1e3:.4g}",
            f"{step.first_sample / programme.rate_hz:.3f}", f"{step.n_samples / programme.rate_hz:.3f}",
        )  # fmt: skip
    print_lines(f"{profile.name}: {profile.forcing.frequency_hz:g} Hz, c = {profile.forcing.ratio}; peaks from rest")
    print_table(table)
    print_lines(GAMMA)
    if left_out:
        print_lines(f"{left_out} steps in the middle are not shown; --json FILE writes all of them")
    seconds = programme.n_samples / programme.rate_hz
    print_lines(f"{len(rows)} steps, {duration(seconds)}, {programme.n_samples} samples at {programme.rate_hz:g} Hz")
