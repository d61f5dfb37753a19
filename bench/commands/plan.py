"""`bench plan`: every step of a ramp in figures, before anything moves; what a limit forbids is refused."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_USAGE, GAMMA, fail, new_table, print_lines, print_table, write_json

if TYPE_CHECKING:
    from rig.programme.ramp import Peaks, Programme, Step

MOST_ROWS = 1000
"""Rows of the table; of a longer ramp its first and last half as many."""


def command(
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
        _print(programme, rows)
        if (stake := checked.stake) is not None:
            print_lines(f"{' + '.join(stake.named)} is staked on it: bench stake holds the run against its prediction")
    if faults:
        fail(refusal(profile, faults), EXIT_USAGE)


def _print(programme: Programme, rows: list[tuple[Step, Peaks]]) -> None:
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
