"""`bench ramp`: drive a profile's ramp through its back end and record it."""

from __future__ import annotations

import datetime
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench import outputs
from bench.outputs import File, check_outputs
from bench.terminal.console import fail, next_command, readable, warn, write_json

if TYPE_CHECKING:
    from rig.backends.base import Backend
    from rig.execution.operator import RunSummary


def command(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    out: Path = typer.Option(..., "--out", metavar="REC.h5", help="The recording; never overwritten."),
    real_time: outputs.RealTime = False,
    scenario: outputs.Scenario = None,
    seed: outputs.Seed = 0,
    replay: Path | None = typer.Option(None, "--replay", metavar="REC.h5", help="What a replay back end plays."),
    note: str | None = typer.Option(None, "--note", help="The operator's note."),
    set_: list[str] = typer.Option([], "--set", metavar="KEY=VALUE", help="A free key, as knob=3; repeatable."),
    resume: Path | None = typer.Option(None, "--resume", metavar="REC.h5", help="Go on where this recording stopped."),
    step: int | None = typer.Option(None, "--step", metavar="N", help="With --resume: repeat only step N."),
    json: outputs.Json = None,
    live: outputs.Live = False,
    host: outputs.Host = "127.0.0.1",
    port: outputs.Port = None,
    hold_branch: bool = typer.Option(
        False, "--hold-branch", help="Hold the ball on the locked cycle, also where that is not stable."
    ),
    watch: bool = typer.Option(False, "--watch", help="Print after each step how the residuals stand."),
    overwrite: outputs.Overwrite = False,
) -> None:
    """Run a profile's ramp and record it; Ctrl-C ramps the drive down and keeps the recording.

    Example: bench ramp simulated --out first.h5 --note "first light"

    With --hold-branch (or [control.branch] in the profile) the ball is held on its locked cycle beyond the period
    doubling, by corrections of at most 2 % of the drive; it must begin where that cycle is stable.

    With --live or --watch a simulated rig is paced to the clock, as with --real-time.

    Exits 0 when the ramp was completed, 1 when it was stopped or failed (what was recorded is there), 2 when the call
    was wrong.
    """
    from bench.jobs.hold_branch import branch_hold
    from bench.jobs.run_ramp import continued, make_backend, record
    from bench.live.processes import Onlookers
    from bench.profiles.find import load, refuse_forbidden
    from bench.terminal.run_console import free_keys
    from daq.setup.setup import calibration_warnings

    check_outputs(
        File("--out", out, outputs.HDF5, lasting=True), File("--json", json, outputs.JSON),
        inputs=[profile, scenario, replay, resume], overwrite=overwrite,
    )  # fmt: skip
    checked, text = load(profile)
    checked, named = continued(checked, resume, step)
    extra = free_keys([str(readable(one)) for one in set_]) | named
    refuse_forbidden(profile, checked)
    for doubt in calibration_warnings(checked, datetime.date.today()):
        warn(f"{profile}: {doubt}")
    hold = branch_hold(checked) if hold_branch or (checked.control and checked.control.branch) else None
    watched = live or watch
    backend = make_backend(checked, scenario=scenario, seed=seed, real_time=real_time, watched=watched, replay=replay)
    page = (host, port) if live else None
    with Onlookers(out.parent, page, watch=watch) as onlookers, onlookers.of_run(checked, text) as onlooker:
        summary = record(checked, text, backend, out, note=readable(note), extra=extra, quiet=json == "-" or watch,
                         paced=real_time or watched, onlooker=onlooker, hold=hold)  # fmt: skip
    _report(summary, backend, out, json, None if checked.stake is None else profile)


def _report(summary: RunSummary, backend: Backend, out: Path, json: str | None, stake: str | None) -> None:
    """Write the summary of a run for a machine, or print it in a sentence; exit 1 where it is not complete."""
    about = {"recording": out if summary.n_samples else None, "backend": backend.name, "simulated": backend.simulated}
    if write_json(about | asdict(summary), json):
        sentence = f"{summary.how}: nothing was recorded, and no file is left"
        if summary.n_samples:
            sentence = (
                f"{summary.how}: {summary.steps_driven} of {summary.steps_planned} steps, {summary.n_samples} samples, "
                f"{summary.lost_samples} lost, in {summary.wall_s:.1f} s -> {out}"
            )
        with suppress(OSError):  # the terminal may be gone; the exit code tells
            typer.echo(sentence)
            if summary.let_go:
                typer.echo(f"the ball was not held to the end: {summary.let_go}")
            if summary.steps_driven:
                typer.echo(next_command(out, stake))
    if summary.how != "complete":
        fail(f"{summary.how}: {summary.why}")
