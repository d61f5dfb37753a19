"""`bench verify`: what state a recording is in."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_FAILED, print_lines, write_json


def command(
    recording: Path = typer.Argument(..., metavar="FILE", help="Recording to check."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Say whether a recording is complete, stopped, incomplete or damaged, and where. Every byte is read.

    Leaves with 0 for complete or stopped, 1 for incomplete or damaged, 2 when FILE is no recording.

    Example: bench verify run.h5
    """
    from daq.files.json_values import json_values
    from daq.recording.verify import verify

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    report = verify(recording)
    if write_json({"file": recording, **json_values(report)}, json):
        seconds = report.n_samples / report.rate_hz if report.n_samples else 0.0
        summary = f"{report.state}: {recording} ({report.n_samples} samples, {seconds:.3f} s)"
        print_lines(summary, *(f"  {line}" for line in report.where))
    if report.state in ("incomplete", "damaged"):
        raise typer.Exit(EXIT_FAILED)
