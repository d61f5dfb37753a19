"""`bench close-loop`: find the residual, name the missing effect, before and after; `bench stake`: a later run."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench import outputs
from bench.outputs import File, Folder, check_outputs
from bench.terminal.console import EXIT_FAILED, fail, print_lines, progress_bar, speaker, warn, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from analysis.loop.close_loop import FittedLoop
    from analysis.loop.design import Ranked
    from analysis.loop.result import ClosedLoop
    from analysis.loop.term_effect import TermEffect


def command(
    recordings: list[Path] = typer.Argument(help="Recordings of one rig; their steps are judged together."),
    profile: Path | None = typer.Option(None, "--profile", help="A profile that replaces the recordings' own."),
    json: outputs.Json = None,
    report: Path | None = typer.Option(None, "--report", metavar="FOLDER", help="Write the report with its pictures."),
    improved: Path | None = typer.Option(None, "--improved", metavar="PROFILE", help="Write the improved profile."),
    next_run: Path | None = typer.Option(None, "--next-run", metavar="PROFILE", help="Write the best next profile."),
    stake: Path | None = typer.Option(
        None, "--stake", metavar="PROFILE", help="Stake the verdict on a ramp never driven; bench stake judges it."
    ),
    until_clear: bool = typer.Option(False, "--until-clear", help="On the simulated rig: run again while sets tie."),
    scenario: outputs.Scenario = None,
    seed: int = typer.Option(100, "--seed", help="Of the noise of runs made by --until-clear."),
    keep_term: str | None = typer.Option(None, "--keep-term", metavar="NAME", help="Try a found term as an effect."),
    runs_differ: bool = typer.Option(False, "--runs-differ", help="Runs of different days, each calibrated by itself."),
    summaries: Path | None = typer.Option(None, "--summaries", metavar="FILE", help="Of --runs-differ, to go on with."),
    anyway: outputs.Anyway = False,
    overwrite: outputs.Overwrite = False,
) -> None:
    """Find where measurement and model part, name the missing effect, and report the error before and after.

    Example: bench close-loop run.h5 --report report --improved better.toml

    The verdict is saved next to the recording (run.loop), where bench report and bench runs find it.

    A term discovered outside the library becomes an effect by --keep-term sticky_rod: a file in the user's folder of
    effects, which every later call finds by its name. The loop is closed again with it; --improved is then of that.

    Tens of runs of one rig over months: bench close-loop runs/*.h5 --runs-differ. One recording is in memory at a time.

    Exits 0 whatever the verdict; 1 when a run made by --until-clear failed or an output could not be written (the
    verdict is shown all the same); 2 when the call or a file was wrong.
    """
    from bench.jobs.loops import holds_summaries, judge_runs, place_for

    check_outputs(
        File("--json", json, outputs.JSON), Folder("--report", report, outputs.REPORT),
        File("--improved", improved, outputs.PROFILE), File("--next-run", next_run, outputs.PROFILE),
        File("--summaries", summaries, outputs.ROWS, continues=holds_summaries),
        File("--stake", stake, outputs.PROFILE), inputs=[*recordings, profile, scenario], overwrite=overwrite,
    )  # fmt: skip
    effect_file = None if keep_term is None else place_for(keep_term, overwrite=overwrite)
    if summaries is not None and not runs_differ:
        raise InputError("--summaries: are of runs that differ only; give --runs-differ as well, or leave it out")
    _check_recordings(recordings)
    if runs_differ:
        single = {
            "improved": improved, "next-run": next_run, "stake": stake, "until-clear": until_clear,
            "keep-term": keep_term,
        }  # fmt: skip
        if given := [f"--{name}" for name, value in single.items() if value]:
            why = "belongs to a single run or to runs alike, and --runs-differ was given; leave out one of them"
            raise InputError(f"{', '.join(given)}: {why}")
        complete = judge_runs(recordings, profile, summaries, json, report, anyway=anyway)
    else:
        wanted = _Wanted(json, report, improved, next_run, stake, effect_file, profile)
        complete = _close(recordings, wanted, (scenario, seed) if until_clear else None, anyway=anyway)
    if not complete:
        raise SystemExit(EXIT_FAILED)


def _check_recordings(recordings: list[Path]) -> None:
    """Refuse a file that is missing; warn of scales whose calibration was old when the recordings were made."""
    from daq.recording import open_recording
    from daq.setup.errors import require_file
    from daq.setup.setup import calibration_warnings

    for path in recordings:
        require_file(path)
    found: dict[str, list[Path]] = {}
    for path in recordings:
        with open_recording(path) as recording:
            started = str(recording.attrs.get("started", ""))[:10]
            today = datetime.datetime.now(datetime.UTC).date()
            on = datetime.date.fromisoformat(started) if started else today
            for doubt in calibration_warnings(recording.setup, on):
                found.setdefault(doubt, []).append(path)
    for doubt, those in found.items():
        more = f" and {len(those) - 1} more" if len(those) > 1 else ""
        warn(f"{those[0]}{more}: {doubt}")


@dataclass(frozen=True)
class _Wanted:
    """Paths of the outputs, and the profile by which the loop is closed, if not the recordings' own."""

    json: str | None
    report: Path | None
    improved: Path | None
    next_run: Path | None
    stake: Path | None
    effect_file: Path | None
    profile: Path | None


def _close(recordings: list[Path], wanted: _Wanted, again: tuple[Path | None, int] | None, *, anyway: bool) -> bool:
    """Close the loop, show the verdict, write what is wanted: whether all could be; ``again``: scenario and seed."""
    from analysis.loop.close_loop import fit_loop
    from bench.jobs.loops import until_clear
    from bench.profiles.find import load_measuring

    quiet, failure, text = wanted.json == "-", "", None
    if again is not None:
        loop, fitted, recordings, failure = until_clear(
            recordings, *again, say=speaker(quiet), quiet=quiet, anyway=anyway
        )
    else:
        setup, text = (None, None) if wanted.profile is None else load_measuring(wanted.profile)
        with progress_bar(quiet) as bar:
            loop, fitted = fit_loop(recordings, setup=setup, progress=bar, anyway=anyway)
    complete = _write(loop, fitted, recordings, wanted, text)
    if failure:
        fail(failure)
    return complete


def _write(loop: ClosedLoop, fitted: FittedLoop, recordings: list[Path], wanted: _Wanted, text: str | None) -> bool:
    """Show the verdict and write what is wanted; ``text`` is that of the profile, if not the recordings' own."""
    from analysis.loop.design import ranking_json
    from analysis.loop.tables import loop_json
    from analysis.report.wording import term_effect_in_words
    from bench.jobs.blocks import write_stake
    from bench.jobs.loops import conclude, drawn, keep_term
    from bench.profiles.improved import possible_runs, profile_of, profile_text, write_improved
    from daq.files.disk import write_whole

    say = speaker(quiet := wanted.json == "-")
    ranked: list[Ranked] = []
    term_effect: TermEffect | None = None

    def keep(path: Path) -> None:
        nonlocal term_effect
        term_effect, improved = keep_term(loop, path, recordings, wanted.profile, wanted.improved, quiet=quiet)
        lines([*term_effect_in_words(term_effect), *improved])

    def rank(first: Path) -> None:
        ranked.extend(possible_runs(loop, fitted, first))
        for run in ranked[:3]:
            say(f"  a next run worth {run.nats:.0f} nats: {run.design.description}")

    def report(folder: Path) -> None:
        say(f"report: {drawn(loop, folder, quiet=quiet, recording=recordings[0], term_effect=term_effect)}")

    def lines(found: list[str]) -> None:
        for line in found:
            say(line)

    def following(path: Path) -> None:
        if ranked:
            write_whole(path, profile_of(profile_text(recordings[0]), ranked[0].design))
            say(f"next run: {path} ({ranked[0].design.description})")
        else:
            say(f"next run: {path} is not written, because nothing ties that another run would separate")

    # the order matters: ranking and the term's effect are part of the JSON; the profile is then that of the second loop
    possible: list[tuple[str, Callable[[Any], object], object]] = [
        ("the term's effect", keep, wanted.effect_file), ("list of next runs", rank, recordings[0]),
        ("verdict as JSON", lambda to: write_json(loop_json(loop, ranking_json(ranked), term_effect), to), wanted.json),
        ("report", report, wanted.report),
        (
            "improved profile", lambda path: lines(write_improved(loop, recordings[0], path, text)),
            wanted.improved if wanted.effect_file is None else None,
        ),
        ("next run's profile", following, wanted.next_run),
        ("stake", lambda path: lines(write_stake(loop, fitted, recordings, text, path)), wanted.stake),
    ]  # fmt: skip
    writers = [(name, partial(write, to)) for name, write, to in possible if to is not None]
    return conclude(loop, recordings, writers, quiet=quiet)


def stake(
    prediction: Path = typer.Argument(metavar="stake", help="The prediction, written by bench close-loop --stake."),
    recording: Path = typer.Argument(help="The run of its ramp, made by bench ramp after it was written."),
    json: outputs.Json = None,
    overwrite: outputs.Overwrite = False,
) -> None:
    """Hold a later run against the prediction that a verdict staked on it: met, or the verdict is withdrawn.

    Example: bench stake stake.toml next.h5

    Nothing is fitted. Parameters stay as they are in the file, those of the instruments too; their covariance and the
    run's own noise make the intervals. A saved verdict (run.loop) on the staked recordings is amended.

    Exits 0 whether it is met or not, 2 when the call was wrong or the run is of another rig.
    """
    from bench.jobs.blocks import amended, outcome_of, read_stake

    check_outputs(File("--json", json, outputs.JSON), inputs=[prediction, recording], overwrite=overwrite)
    staked, text = read_stake(prediction)
    outcome = outcome_of(staked, text, recording)
    verdict = amended(staked, outcome, recording)
    steps = [
        vars(s.staked) | {"median_us": s.median_us, "half_us": s.half_us, "landings": s.landings, "met": s.met}
        for s in outcome.steps
    ]
    answer = {
        "met": outcome.met, "words": outcome.words, "named": staked.named, "rival": staked.rival, "steps": steps,
        "flights": outcome.flights, "plate": outcome.plate, "verdict": verdict,
    }  # fmt: skip
    if write_json(answer, json):
        from bench.terminal.loop_display import show_stake

        show_stake(staked, outcome)
        print_lines(*([] if verdict is None else [f"verdict amended: {verdict}"]))
