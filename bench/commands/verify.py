"""`bench verify`: what state a recording is in."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import typer

from bench.outputs import JSON, File, Overwrite, check_outputs
from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, write_json


def command(
    recording: Path = typer.Argument(..., metavar="FILE", help="Recording to check."),
    json_out: str = typer.Option(None, "--json", metavar="FILE", help="Write the report as JSON; - is the screen."),
    overwrite: Overwrite = False,
) -> None:
    """Say whether a recording is complete, stopped, incomplete or damaged, and where. Every byte is read.

    Leaves with 0 for complete or stopped, 1 for incomplete or damaged, 2 when FILE is no recording.

    Example: bench verify run.h5
    """
    from daq.recording.verify import verify
    from daq.setup.errors import InputError

    try:
        check_outputs(File("--json", json_out, JSON), inputs=[recording], overwrite=overwrite)
        report = verify(recording)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    if json_out != "-":
        seconds = report.n_samples / report.rate_hz if report.n_samples else 0.0
        typer.echo(f"{report.state}: {recording} ({report.n_samples} samples, {seconds:.3f} s)")
        for line in report.where:
            typer.echo(f"  {line}")
    payload = dataclasses.asdict(report)
    if not report.n_samples:
        payload["rate_hz"] = None  # a damaged file may not say; JSON has no NaN
    write_json({"file": recording, **payload}, json_out)
    if report.state in ("incomplete", "damaged"):
        raise typer.Exit(EXIT_FAILED)
