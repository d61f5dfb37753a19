"""`bench ramp`: drive a profile's ramp through its back end and record it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from rig.backends.base import Backend
    from rig.execution.operator import RunSummary
    from rig.profile import Profile


def command(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    out: Path = typer.Option(..., "--out", metavar="REC.h5", help="The recording; never overwritten."),
    real_time: bool = typer.Option(False, "--real-time", help="Pace the simulated rig to the clock."),
    scenario: Path | None = typer.Option(None, "--scenario", metavar="FILE", help="What the simulated rig hides."),
    seed: int = typer.Option(0, "--seed", min=0, help="Of the simulated rig's noise."),
    replay: Path | None = typer.Option(None, "--replay", metavar="REC.h5", help="What a replay back end plays."),
    note: str | None = typer.Option(None, "--note", help="The operator's note."),
    set_: list[str] = typer.Option([], "--set", metavar="KEY=VALUE", help="A free key, as knob=3; repeatable."),
    resume: Path | None = typer.Option(None, "--resume", metavar="REC.h5", help="Go on where this recording stopped."),
    step: int | None = typer.Option(None, "--step", metavar="N", help="With --resume: repeat only step N."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The summary for a machine; - prints it."),
    live: bool = typer.Option(False, "--live", help="Serve a page on which the run is watched and stopped."),
    host: str = typer.Option("127.0.0.1", "--host", help="Of the page; other machines need the token in its address."),
    port: int | None = typer.Option(None, "--port", min=0, max=65535, help="Of the page; by default a free one."),
    watch: bool = typer.Option(False, "--watch", help="Print after each step how the residuals stand."),
    overwrite: Overwrite = False,
) -> None:
    """Run a profile's ramp and record it; Ctrl-C ramps the drive down and keeps the recording.

    Example: bench ramp simulated --out first.h5 --note "first light"

    With --live or --watch a simulated rig is paced to the clock, as with --real-time.

    Exits 0 when the ramp was completed, 1 when it was stopped or failed (what was recorded is kept), 2 when the call
    was wrong.
    """
    import datetime

    from bench.jobs.run_ramp import make_backend, record
    from bench.live.onlooker import onlooking
    from bench.outputs import HDF5, JSON, File, check_outputs
    from bench.profiles.find import load
    from bench.profiles.plan import planned, refusal
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, readable, warn
    from bench.terminal.orders import free_keys
    from daq.setup.calibration_age import calibration_warnings
    from daq.setup.errors import InputError

    try:
        check_outputs(
            File("--out", out, HDF5, kept=True), File("--json", json, JSON),
            inputs=[profile, scenario, replay, resume], overwrite=overwrite,
        )  # fmt: skip
        checked, text = load(profile)
        checked, extra = _resumed(checked, resume, step, free_keys([str(readable(one)) for one in set_]))
        if faults := planned(checked)[2]:
            raise InputError(refusal(profile, faults))
        for doubt in calibration_warnings(checked, datetime.date.today()):
            warn(f"{profile}: {doubt}")
        paced = real_time or live or watch
        backend = make_backend(checked, scenario=scenario, seed=seed, real_time=paced, replay=replay)
        with onlooking(checked, out.parent, page=(host, port) if live else None, watch=watch) as onlooker:
            summary = record(checked, text, backend, out, note=readable(note), extra=extra, quiet=json == "-" or watch,
                             paced=paced, onlooker=onlooker)  # fmt: skip
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(str(error), EXIT_FAILED)
    _report(summary, backend, out, json)


def _resumed(
    profile: Profile, resume: Path | None, step: int | None, keys: dict[str, Any]
) -> tuple[Profile, dict[str, Any]]:
    """The profile and free keys of a run that goes on where a recording stopped, or unchanged. Raises `InputError`."""
    from bench.jobs.resume import continued
    from daq.setup.errors import InputError

    if resume is None:
        if step is not None:
            raise InputError(f"--step {step}: name the recording whose step it repeats by --resume REC.h5")
        return profile, keys
    profile, named = continued(profile, resume, step)
    return profile, keys | named


def _report(summary: RunSummary, backend: Backend, out: Path, json: str | None) -> None:
    """Write the summary of a run for a machine, or print it in a sentence; exit 1 where it is not complete."""
    from contextlib import suppress

    from bench.terminal.console import EXIT_FAILED, fail, next_command, write_json

    about = {"recording": out if summary.n_samples else None, "backend": backend.name, "simulated": backend.simulated}
    write_json(about | asdict(summary), json)
    if json != "-":
        with suppress(OSError):  # the terminal may be gone; the exit code tells
            typer.echo(_sentence(summary, out))
            if summary.steps_driven:
                typer.echo(next_command(out))
    if summary.how != "complete":
        fail(f"{summary.how}: {summary.why}", EXIT_FAILED)


def _sentence(summary: RunSummary, out: Path) -> str:
    """The outcome of a run in one line."""
    if not summary.n_samples:
        return f"{summary.how}: nothing was recorded, and no file is left"
    return (
        f"{summary.how}: {summary.steps_driven} of {summary.steps_planned} steps, {summary.n_samples} samples, "
        f"{summary.lost_samples} lost, in {summary.wall_s:.1f} s -> {out}"
    )
