"""`bench close-loop`: find the residual, name the missing effect, report the error before and after."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import Anyway, Overwrite

if TYPE_CHECKING:
    from analysis.loop.close_loop import FittedLoop
    from analysis.loop.design import Ranked
    from analysis.loop.kept_term import KeptTerm
    from analysis.loop.result import ClosedLoop

Output = tuple[str, Callable[[], None]]


def command(
    recordings: list[Path] = typer.Argument(help="Recordings of one rig; their steps are judged together."),
    profile: Path | None = typer.Option(None, "--profile", help="A profile that replaces the recordings' own."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The verdict for a machine; - prints it."),
    report: Path | None = typer.Option(None, "--report", metavar="FOLDER", help="Write the report with its pictures."),
    improved: Path | None = typer.Option(None, "--improved", metavar="PROFILE", help="Write the improved profile."),
    next_run: Path | None = typer.Option(None, "--next-run", metavar="PROFILE", help="Write the best next profile."),
    until_clear: bool = typer.Option(False, "--until-clear", help="On the simulated rig: run again while sets tie."),
    scenario: Path | None = typer.Option(None, "--scenario", metavar="FILE", help="What that rig hides."),
    seed: int = typer.Option(100, "--seed", help="Of the noise of runs made by --until-clear."),
    keep_term: str | None = typer.Option(
        None, "--keep-term", metavar="NAME", help="Keep a discovered term as an effect of that name, and try it."
    ),
    runs_differ: bool = typer.Option(
        False, "--runs-differ", help="Recordings of different days: each has calibrations of its own."
    ),
    summaries: Path | None = typer.Option(
        None, "--summaries", metavar="FILE", help="With --runs-differ: keep each run's summary there, to go on."
    ),
    anyway: Anyway = False,
    overwrite: Overwrite = False,
) -> None:
    """Find where measurement and model part, name the missing effect, and report the error before and after.

    Example: bench close-loop run.h5 --report report --improved better.toml

    The verdict is saved next to the recording (run.loop), where bench report and bench runs find it.

    A term discovered outside the library becomes an effect by --keep-term sticky_rod: a file in the folder of kept
    effects, which every later call finds by its name. The loop is closed again with it; --improved is then of that.

    Tens of runs of one rig over months: bench close-loop runs/*.h5 --runs-differ. One recording is in memory at a time.

    Exits 0 whatever the verdict; 1 when a run made by --until-clear failed or an output could not be written (the
    verdict is shown all the same); 2 when the call or a file was wrong.
    """
    from bench.jobs.joint_runs import judge_runs
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail
    from daq.setup.errors import InputError

    wanted = _Wanted(json, report, improved, next_run, keep_term, overwrite, anyway)
    failure, complete = "", True
    try:
        kept_as = _check(
            recordings, profile, summaries, scenario, wanted, until_clear=until_clear, runs_differ=runs_differ
        )
        if runs_differ:
            complete = judge_runs(recordings, profile, summaries, json, report, anyway=anyway)
        else:
            writers, failure = _closed(recordings, profile, wanted, (scenario, seed) if until_clear else None)
    except (InputError, ValueError) as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{error}; name a file that can be read", EXIT_USAGE)
    if not runs_differ:
        complete = writers.write(wanted, kept_as, profile)
    if failure:
        fail(failure, EXIT_FAILED)
    if not complete:
        raise SystemExit(EXIT_FAILED)


@dataclass(frozen=True)
class _Wanted:
    """Outputs that are to be written, and their paths."""

    json: str | None
    report: Path | None
    improved: Path | None
    next_run: Path | None
    keep_term: str | None
    overwrite: bool
    anyway: bool

    @property
    def quiet(self) -> bool:
        """Whether standard output belongs to the JSON."""
        return self.json == "-"


def _closed(
    recordings: list[Path], profile: Path | None, wanted: _Wanted, again: tuple[Path | None, int] | None
) -> tuple[_Writers, str]:
    """The loop closed on all recordings as one run, and why a run that was to follow could not be made.

    ``again`` is what the simulated rig hides, and the seed of further runs on it.
    """
    from analysis.loop.close_loop import fit_loop
    from bench.jobs.adaptive_runs import until_clear
    from bench.profiles.find import load_measuring
    from bench.terminal.console import speaker
    from bench.terminal.progress import progress_bar

    say = speaker(wanted.quiet)
    if again is not None:
        loop, fitted, made, failure = until_clear(recordings, *again, say=say, quiet=wanted.quiet, anyway=wanted.anyway)
        return _Writers(loop, fitted, made, None, say), failure
    setup, text = (None, None) if profile is None else load_measuring(profile)
    with progress_bar(wanted.quiet) as bar:
        loop, fitted = fit_loop(recordings, setup=setup, progress=bar, anyway=wanted.anyway)
    return _Writers(loop, fitted, recordings, text, say), ""


@dataclass
class _Writers:
    """Writers of the outputs of one closed loop; ``text`` is the profile by which it was closed, if not its own."""

    loop: ClosedLoop
    fitted: FittedLoop
    recordings: list[Path]
    text: str | None
    say: Callable[[str], None]
    ranked: list[Ranked] = field(default_factory=list)
    kept: KeptTerm | None = None

    @property
    def recording(self) -> Path:
        """The first recording."""
        return self.recordings[0]

    def write(self, wanted: _Wanted, kept_as: Path | None, profile: Path | None) -> bool:
        """Show the verdict and write what is wanted, a discovered term to ``kept_as``; whether all could be written."""
        from bench.jobs.keep_verdict import conclude

        steps: list[Output] = []
        improved = wanted.improved
        if kept_as is not None:
            steps.append(("kept term", lambda: self.keep_term(kept_as, profile, wanted.improved, quiet=wanted.quiet)))
            improved = None
        steps += [("list of next runs", self.rank), ("verdict as JSON", lambda: self.verdict(wanted.json))]
        if (report := wanted.report) is not None:
            steps.append(("report", lambda: self.report(report, quiet=wanted.quiet)))
        if improved is not None:
            steps.append(("improved profile", lambda: self.improved(improved)))
        if (next_run := wanted.next_run) is not None:
            steps.append(("next run's profile", lambda: self.next_run(next_run)))
        return conclude(self.loop, self.recordings, steps, quiet=wanted.quiet)

    def keep_term(self, path: Path, profile: Path | None, improved: Path | None, *, quiet: bool) -> None:
        from analysis.report.wording import kept_in_words
        from bench.jobs.keep_term import keep_term

        self.kept, lines = keep_term(self.loop, path, self.recordings, profile, improved, quiet=quiet)
        for line in (*kept_in_words(self.kept), *lines):
            self.say(line)

    def rank(self) -> None:
        from bench.profiles.next_run import possible_runs

        self.ranked = possible_runs(self.loop, self.fitted, self.recording)
        for run in self.ranked[:3]:
            self.say(f"  a next run worth {run.nats:.0f} nats: {run.design.description}")

    def verdict(self, json: str | None) -> None:
        from analysis.loop.design import ranking_json
        from analysis.loop.verdict_json import loop_json
        from bench.terminal.console import write_json

        write_json(loop_json(self.loop, ranking_json(self.ranked), self.kept), json)

    def report(self, folder: Path, *, quiet: bool) -> None:
        from analysis.report.page import write_report
        from bench.terminal.progress import progress_bar

        with progress_bar(quiet) as bar:
            page = write_report(self.loop, folder, progress=bar, kept=self.kept)
        self.say(f"report: {page}")

    def improved(self, path: Path) -> None:
        from bench.profiles.improved import write_improved

        for line in write_improved(self.loop, self.recording, path, self.text):
            self.say(line)

    def next_run(self, path: Path) -> None:
        from bench.profiles.next_run import write_next

        if self.ranked:
            write_next(self.ranked, self.recording, path)
            self.say(f"next run: {path} ({self.ranked[0].design.description})")
        else:
            self.say(f"next run: {path} is not written, because nothing ties that another run would separate")


def _check(
    recordings: list[Path],
    profile: Path | None,
    summaries: Path | None,
    scenario: Path | None,
    wanted: _Wanted,
    *,
    until_clear: bool,
    runs_differ: bool,
) -> Path | None:
    """Refuse outputs that are in the way, options that do not go together, and recordings that are not there.

    Returns the file of a term that is to be kept.
    """
    from bench.jobs.joint_runs import holds_summaries
    from bench.jobs.keep_term import place_for
    from bench.outputs import JSON, PROFILE, REPORT, ROWS, File, Folder, check_outputs
    from daq.setup.errors import InputError

    check_outputs(
        File("--json", wanted.json, JSON), Folder("--report", wanted.report, REPORT),
        File("--improved", wanted.improved, PROFILE), File("--next-run", wanted.next_run, PROFILE),
        File("--summaries", summaries, ROWS, continues=holds_summaries),
        inputs=[*recordings, profile, scenario], overwrite=wanted.overwrite,
    )  # fmt: skip
    kept_as = None if wanted.keep_term is None else place_for(wanted.keep_term, overwrite=wanted.overwrite)
    single = {
        "--improved": wanted.improved, "--next-run": wanted.next_run,
        "--until-clear": until_clear, "--keep-term": kept_as,
    }  # fmt: skip
    if summaries is not None and not runs_differ:
        raise InputError("--summaries: is kept of runs that differ only; give --runs-differ as well, or leave it out")
    given = [option for option, value in single.items() if value]
    if runs_differ and given:
        raise InputError(
            f"{', '.join(given)}: belongs to a single run or to runs alike, and --runs-differ was given; leave out one "
            "of them"
        )
    _check_recordings(recordings)
    return kept_as


def _check_recordings(recordings: list[Path]) -> None:
    """Refuse a file that is missing; warn of scales whose calibration was old when the recordings were made."""
    from bench.terminal.console import warn
    from daq.recording import open_recording
    from daq.setup.calibration_age import warnings_at_start
    from daq.setup.errors import require_file

    for path in recordings:
        require_file(path)
    for path in recordings:
        with open_recording(path) as recording:
            for doubt in warnings_at_start(recording.setup, str(recording.attrs.get("started", ""))):
                warn(f"{path}: {doubt}")
