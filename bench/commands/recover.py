"""`bench recover`: a whole recording from one that was cut off or is damaged."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import HDF5, JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_FAILED, print_lines, write_json


def command(
    recording: Path = typer.Argument(..., metavar="FILE", help="Recording, cut off or damaged; it is only read."),
    out: Path = typer.Option(None, "--out", "-o", metavar="REC.h5", help="File to create [NAME.recovered.h5]."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Rebuild a verified recording from one that was cut off by a kill, a crash or a full disk, or that is damaged.

    Every block whose writing had been acknowledged is there; what is damaged is put right from the checksums, or is a
    gap. The new file says that it was recovered, and what was damaged. Leaves with 1 where something is gone.

    Example: bench recover run.h5 --out run.recovered.h5
    """
    from daq.recording.recover import default_out, recover

    out = out or default_out(recording)
    check_outputs(
        File("--out", out, HDF5, lasting=True), File("--json", json, JSON), inputs=[recording], overwrite=overwrite
    )
    found = recover(recording, out)
    if write_json(found, json):
        summary = f"{found.path}: {found.n_samples} samples, {found.n_steps} steps recovered"
        print_lines(summary, *(f"  {line}" for line in found.damage))
    if found.is_less:
        raise typer.Exit(EXIT_FAILED)
