"""`bench demo`: the main job end to end on a simulated rig that hides something nobody declared."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rig.sim.scenario import Scenario


def command(
    out: Path | None = typer.Option(None, "--out", metavar="FOLDER", help="Where everything goes; default runs/DATE."),
    profile: str = typer.Option("simulated", "--profile", help="A profile's path, or the name of a shipped one."),
    scenario: Path | None = typer.Option(
        None, "--scenario", metavar="FILE", help="What the rig hides; default: sealed."
    ),
    seed: int = typer.Option(4, "--seed", help="Of the sealed draw and of the rig's noise."),
) -> None:
    """Drive a ramp on a sealed simulated rig, record it, reprocess it, hold it against the model, close the loop.

    Example: bench demo --seed 7

    What the rig hides is drawn by chance and written to a sealed file, opened only after the report is written.
    """
    import datetime
    import time

    from bench.console import EXIT_USAGE, fail
    from bench.outputs import Folder, check_outputs
    from bench.profiles import find_scenario
    from daq.errors import InputError
    from rig.sim.scenario import load_scenario

    started = time.perf_counter()
    folder = out or Path("runs") / datetime.datetime.now().strftime("%Y-%m-%d_%H%M%S")
    try:
        check_outputs(Folder("--out", folder, makes=()), inputs=[profile, scenario])
        folder.mkdir(parents=True, exist_ok=False)
        sealed = folder / "sealed.toml"
        hidden = _sealed(seed) if scenario is None else load_scenario(find_scenario(scenario))
        sealed.write_text(hidden.to_toml(), encoding="utf-8")
        recording = _drive(profile, folder, sealed, seed)
        _reprocess(recording, folder)
        page, verdict = _close(recording, folder)
    except FileExistsError:
        fail(f"{folder}: exists already; name a new folder by --out", EXIT_USAGE)
    except (InputError, ValueError) as error:
        fail(str(error), EXIT_USAGE)
    names = ", ".join(load_scenario(sealed).effects) or "nothing"
    typer.echo(f"\nthe seal opened: the rig hid {names}; the verdict was: {verdict}")
    for what, path in (
        ("recording", recording),
        ("flights", folder / "flights.csv"),
        ("pictures", folder / "pictures"),
        ("report", page),
        ("improved profile", folder / "improved.toml"),
        ("what was hidden", sealed),
    ):
        typer.echo(f"  {what:<17} {path}")
    typer.echo(f"done in {time.perf_counter() - started:.0f} s")


def _sealed(seed: int) -> Scenario:
    """A scenario drawn by chance among the effects that have a name."""
    import numpy as np

    from rig.sim.sealed import pool, sealed_scenario

    return sealed_scenario(np.random.default_rng(seed), pool("named"), strength="strong")


def _drive(profile: str, folder: Path, sealed: Path, seed: int) -> Path:
    from bench.commands.plan import planned, refusal
    from bench.commands.ramp import make_backend, record
    from bench.console import EXIT_FAILED, fail
    from bench.profiles import load
    from daq.errors import InputError

    checked, text = load(profile)
    faults = planned(checked)[2]
    if faults:
        raise InputError(refusal(profile, faults))
    recording = folder / "recording.h5"
    typer.echo(
        f"1/4  ramp: {checked.name}, c = {checked.forcing.ratio}, {checked.forcing.frequency_hz:g} Hz, simulated rig"
    )
    summary = record(checked, text, make_backend(checked, scenario=sealed, seed=seed), recording)
    if summary.how != "complete":
        fail(f"{summary.how}: {summary.why}", EXIT_FAILED)
    return recording


def _reprocess(recording: Path, folder: Path) -> None:
    from analysis.compare import compare
    from analysis.flight_table import write_csv
    from bench.commands.reprocess import draw, with_progress
    from daq.recording import open_recording

    with open_recording(recording) as opened:
        typer.echo("2/4  reprocess: flights and plate motion from the file, pictures")
        table = with_progress(opened, quiet=False)
        write_csv(table, folder / "flights.csv")
        draw(opened, table, folder / "pictures")
        held = compare(table, opened.setup, steps_table=opened.steps)
    typer.echo(
        f"3/4  compare: {len(table)} flights, {100 * held.short_by:.1f} % shorter than the declared model says, "
        f"{held.double_hits} double hits"
    )


def _close(recording: Path, folder: Path) -> tuple[Path, str]:
    from analysis.close_loop import as_json, close_loop
    from analysis.loop_report import write_report
    from bench.commands.close_loop import progress_bar, show
    from bench.console import write_json
    from bench.improved import write_improved

    typer.echo("4/4  close the loop: which missing effect explains the rest")
    with progress_bar() as say:
        loop = close_loop([recording], progress=say)
        page = write_report(loop, [recording], folder / "report")
    show(loop)
    write_json(as_json(loop), str(folder / "verdict.json"))
    write_improved(loop, recording, folder / "improved.toml")
    return page, f"{loop.verdict} ({', '.join(f.name for f in loop.effects) or 'no effect added'})"
