"""`bench recover`: a whole recording from one that was cut off or is damaged."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import typer

from bench.outputs import HDF5, JSON, File, Overwrite, check_outputs
from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, write_json


def command(
    recording: Path = typer.Argument(..., metavar="FILE", help="Recording, cut off or damaged; it is only read."),
    out: Path = typer.Option(None, "--out", "-o", metavar="REC.h5", help="File to create [NAME.recovered.h5]."),
    json_out: str = typer.Option(None, "--json", metavar="FILE", help="Write the summary as JSON; - is the screen."),
    overwrite: Overwrite = False,
) -> None:
    """Rebuild a verified recording from one that was cut off by a kill, a crash or a full disk, or that is damaged.

    Every block whose writing had been acknowledged is there; what is damaged is put right from the checksums, or is a
    gap. The new file says that it was recovered, and what was damaged. Leaves with 1 where something is gone.

    Example: bench recover run.h5 --out run.recovered.h5
    """
    from daq.recording.recover import default_out, recover
    from daq.setup.errors import InputError

    out = out or default_out(recording)
    try:
        check_outputs(
            File("--out", out, HDF5, kept=True), File("--json", json_out, JSON), inputs=[recording], overwrite=overwrite
        )
        found = recover(recording, out)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{recording}: could not be recovered ({error}).")
    if json_out != "-":
        typer.echo(f"{found.path}: {found.n_samples} samples, {found.n_steps} steps recovered")
        for line in found.damage:
            typer.echo(f"  {line}")
    write_json(dataclasses.asdict(found), json_out)
    if found.is_less:
        raise typer.Exit(EXIT_FAILED)
