"""`bench paper`: the seed paper, figure by figure, as one page."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import Folder, Overwrite, check_outputs
from bench.terminal.console import progress_bar


def command(
    out: Path = typer.Option(Path("paper"), "--out", metavar="FOLDER", help="For page, pictures, tables and runs."),
    profile: str = typer.Option("paper", "--profile", help="The rig whose runs are shown: a path or a shipped name."),
    seed: int = typer.Option(1, "--seed", min=0, help="Of the simulated rigs' noise and instruments."),
    overwrite: Overwrite = False,
) -> None:
    """Draw each figure of the seed paper, measured ones from a rig's runs, and say which effect moves which number.

    Example: bench paper --out paper

    Recordings in FOLDER/runs are used, those that are missing are made on the simulated rig. For a real rig, make them
    first: bench paper --profile rig.toml writes the profile of each run, and says how to record it. No device is
    driven here.
    """
    from bench.jobs.paper import paper
    from bench.profiles.find import load

    check_outputs(Folder("--out", out, makes=("paper.md", "paper/*")), inputs=[profile], overwrite=overwrite)
    with progress_bar() as say:
        paper(load(profile)[1], out, seed, say)
    typer.echo(f"{out / 'paper.md'}: the page; its pictures and tables are in {out / 'paper'}")
