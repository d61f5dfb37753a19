"""`bench close-loop`: find the residual, name the missing effect, report the error before and after."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from analysis.close_loop import Loop


def command(
    recordings: list[Path] = typer.Argument(help="Recordings of one rig; their steps are judged together."),
    profile: Path | None = typer.Option(None, "--profile", help="A profile that replaces the recordings' own."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The verdict for a machine; - prints it."),
    report: Path | None = typer.Option(None, "--report", metavar="FOLDER", help="Write the report with its pictures."),
    improved: Path | None = typer.Option(None, "--improved", metavar="PROFILE", help="Write the improved profile."),
    next_run: Path | None = typer.Option(
        None, "--next-run", metavar="PROFILE", help="Write the best next run's profile."
    ),
    until_clear: bool = typer.Option(False, "--until-clear", help="On the simulated rig: run again while sets tie."),
    scenario: Path | None = typer.Option(None, "--scenario", metavar="FILE", help="What that rig hides."),
    seed: int = typer.Option(100, "--seed", help="Of the noise of runs made by --until-clear."),
    overwrite: Overwrite = False,
) -> None:
    """Find where measurement and model part, name the missing effect, and report the error before and after.

    Example: bench close-loop run.h5 --report report --improved better.toml

    Exits 0 whatever the verdict; 1 when a run made by --until-clear failed; 2 when the call or a file was wrong.
    """
    from analysis.close_loop import as_json, close_loop
    from analysis.next_run import as_json as runs_as_json
    from bench.console import EXIT_USAGE, fail, write_json
    from bench.next_profile import possible_runs, write_next
    from bench.outputs import JSON, PROFILE, REPORT, File, Folder, check_outputs
    from bench.profiles import load_measuring
    from bench.until_clear import until_clear as repeat
    from daq.errors import InputError

    quiet = json == "-"
    say: Callable[[str], None] = _nothing if quiet else typer.echo
    try:
        check_outputs(
            File("--json", json, JSON), Folder("--report", report, REPORT), File("--improved", improved, PROFILE),
            File("--next-run", next_run, PROFILE), inputs=[*recordings, profile, scenario], overwrite=overwrite,
        )  # fmt: skip
        for path in recordings:
            if not path.is_file():
                raise InputError(f"{path}: wanted a recording, there is no such file; name one made by ramp or import")
        _warn_of_calibrations(recordings)
        text: str | None = None
        if until_clear:
            loop, recordings = repeat(recordings, scenario, seed, say=say, quiet=quiet)
        else:
            setup, text = (None, None) if profile is None else load_measuring(profile)
            with progress_bar(quiet) as bar:
                loop = close_loop(recordings, setup=setup, progress=bar)
        ranked = possible_runs(loop, recordings[0])
        write_json(as_json(loop, runs_as_json(ranked)), json)
        if next_run is not None and ranked:
            write_next(ranked, recordings[0], next_run)
            say(f"next run: {next_run} ({ranked[0].design.words})")
        elif next_run is not None:
            say(f"next run: {next_run} is not written, because nothing ties that another run would tell apart")
        _keep(loop, recordings, report, improved, text, say)
        if not quiet:
            show(loop)
            for run in ranked[:3]:
                say(f"  a next run worth {run.nats:.0f} nats: {run.design.words}")
    except (InputError, ValueError) as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{error}; name a file that can be read or written", EXIT_USAGE)


def _warn_of_calibrations(recordings: list[Path]) -> None:
    """Say which scales nobody had measured lately when the recordings were made."""
    from bench.console import warn
    from daq.calibrations import recorded_doubts
    from daq.recording import open_recording

    for path in recordings:
        with open_recording(path) as recording:
            for doubt in recorded_doubts(recording):
                warn(f"{path}: {doubt}")


def _nothing(line: str) -> None:
    """Say nothing: standard output belongs to the JSON."""


def _keep(
    loop: Loop,
    recordings: list[Path],
    report: Path | None,
    improved: Path | None,
    text: str | None,
    say: Callable[[str], None],
) -> None:
    """Write the report and the improved profile where they are asked for."""
    if report is not None:
        from analysis.loop_report import write_report

        say(f"report: {write_report(loop, recordings, report)}")
    if improved is not None:
        from bench.improved import write_improved

        left = write_improved(loop, recordings[0], improved, text)
        say(f"improved profile: {improved}")
        for words in left:
            say(f"  not declared in it: {words}")


@contextmanager
def progress_bar(quiet: bool = False) -> Iterator[Callable[[str, float], None]]:
    """A bar on standard error that follows ``(what, fraction)``."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<34}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=quiet) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda what, part: bar.update(task, description=what, completed=part)


def show(loop: Loop) -> None:
    """The verdict for a person."""
    from rich.console import Console
    from rich.table import Table

    out = Console()
    words = {
        "explained": "explained",
        "unexplained": "unexplained: something is left that no named effect accounts for",
        "nothing_missing": "nothing is missing: the declared model explains the recording",
    }
    out.print(f"\nverdict: [bold]{words[loop.verdict]}[/bold]")
    for found in loop.effects:
        values = ", ".join(f"{k} = {v:.4g} ({lo:.4g} .. {hi:.4g})" for k, (v, lo, hi) in found.parameters.items())
        out.print(f"  + {found.name}: {values}")
    if loop.discovered is not None:
        out.print(f"  discovered: {loop.discovered.in_words}")
    others = [" + ".join(x.names) for x in loop.attribution.ties[1:]]
    if others:
        out.print(f"  the data cannot tell this from: {'; '.join(others)}")
    table = Table("held-out steps", "before", "after", "noise floor")
    b, a = loop.before, loop.after
    table.add_row(
        "landing, rms (us)", f"{b.landing_rms_us:.1f}", f"{a.landing_rms_us:.1f}", f"{loop.noise_floor_us:.1f}"
    )
    table.add_row("landing, robust (us)", f"{b.landing_robust_us:.1f}", f"{a.landing_robust_us:.1f}", "")
    table.add_row(
        "take-off, robust (us)", f"{b.takeoff_robust_us:.1f}", f"{a.takeoff_robust_us:.1f}",
        f"{loop.takeoff_floor_us:.1f}",
    )
    table.add_row("flight time (%)", f"{100 * b.flight_time_relative:.3f}", f"{100 * a.flight_time_relative:.3f}", "")
    out.print(table)
    for line in (*loop.attribution.rounds, *loop.notes):
        out.print(f"  {line}")
