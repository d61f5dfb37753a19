"""`bench ramp`: a profile's ramp driven and recorded; `bench explore`: the rig chooses its own steps."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench import outputs
from bench.outputs import File, Folder, check_outputs
from bench.terminal.console import EXIT_FAILED, fail, next_command, readable, speaker, warn, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from bench.jobs.blocks import Chosen, Driven
    from bench.jobs.explore import Explored
    from bench.live.processes import Onlookers
    from bench.terminal.run_console import TypedLines
    from rig.backends.base import Backend
    from rig.execution.operator import RunSummary


def ramp(
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
    from bench.jobs.run_ramp import branch_hold, continued, make_backend, record
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
    _print(summary, backend, out, json, None if checked.stake is None else profile)


def _print(summary: RunSummary, backend: Backend, out: Path, json: str | None, stake: str | None) -> None:
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


def explore(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    out: Path = typer.Option(..., "--out", metavar="FOLDER", help="For recordings and report; gone on with."),
    until: list[str] = typer.Option([], "--until", help="effect.parameter=deviation asked for; repeatable."),
    limit: float = typer.Option(1.0, "--limit", min=0.01, help="'Nothing missing' down to so much of what matters."),
    budget_s: float | None = typer.Option(None, "--budget", min=1.0, help="Rig seconds; the profile's own ramp's."),
    ratios: str = typer.Option("1,2,3", "--ratios", help="Values of c that may be driven."),
    frequencies: str = typer.Option("", "--frequencies", help="First tones that may be driven, Hz; the profile's."),
    steps: int = typer.Option(4, "--steps", min=2, help="Steps of each block."),
    hold_cycles: int = typer.Option(14, "--hold", min=8, help="Cycles of each step; twice as many while unexplained."),
    settle_cycles: int = typer.Option(4, "--settle", min=0, help="Cycles waited after each fade, for the plate."),
    ask: bool = typer.Option(False, "--ask", help="Ask before each block: go on, other gammas, or stop."),
    real_time: outputs.RealTime = False,
    live: outputs.Live = False,
    host: outputs.Host = "127.0.0.1",
    port: outputs.Port = None,
    scenario: outputs.Scenario = None,
    seed: outputs.Seed = 0,
    json: outputs.Json = None,
    anyway: outputs.Anyway = False,
    overwrite: outputs.Overwrite = False,
) -> None:
    """Let the rig choose its own steps: each block is the one that tells most for a second of rig time.

    Every block is planned, limited and recorded as by bench ramp; Ctrl-C ramps down and keeps what was recorded. Given
    again with the same folder, it goes on there. Within a block, type Enter to hold after the present step; then g to
    go on, other gammas to drive those next, n for another block, or s to stop, each with a reason after a colon.

    Example: bench explore simulated --scenario friction --out found --until coulomb_friction.mu_up=0.005

    Exits 0 when an aim was reached or the budget is spent, 1 when a block failed or was stopped, 2 for a wrong call.
    """
    from bench.jobs.blocks import Aims, run_seconds
    from bench.jobs.explore import explore as explored
    from bench.live.processes import Onlookers
    from bench.profiles.find import load
    from bench.terminal.run_console import typed_lines

    quiet, say = json == "-", speaker(json == "-")
    check_outputs(
        Folder("--out", out, ()), File("--json", json, outputs.JSON), inputs=[profile, scenario], overwrite=overwrite
    )
    checked, text = load(profile)
    aims = Aims(
        budget_s or run_seconds(checked), _targets(until), limit, _numbers(ratios, "--ratios", int),
        _numbers(frequencies, "--frequencies", float), steps, hold_cycles, settle_cycles,
    )  # fmt: skip
    try:
        out.mkdir(parents=True, exist_ok=True)
        typed = typed_lines()
        with Onlookers(out, (host, port) if live else None) as page:
            driver = Driver(scenario, seed, quiet, real_time or live, typed, page)
            found = explored(text, out, aims, driver, say=say, ask=_asker(typed) if ask else None, anyway=anyway)
        complete = quiet or _report(found, out, run_seconds(checked))
    except (OSError, KeyboardInterrupt) as error:
        fail(f"{str(error) or 'interrupted'}; what was recorded is in {out}: the same call goes on there")
    _answer(found, aims.budget_s, json)
    say(f"{found.why}; {len(found.blocks)} blocks, {found.rig_s:.1f} s of rig time")
    if found.failed or not complete:
        raise SystemExit(EXIT_FAILED)


def _answer(found: Explored, budget_s: float, json: str | None) -> None:
    """Write the outcome for a machine."""
    from analysis.loop.tables import loop_json

    blocks = [
        {"recording": path, "seconds": block.seconds, "reason": block.reason}
        for path, block in zip(found.recordings, found.blocks, strict=True)
    ]
    verdict = None if found.loop is None else loop_json(found.loop)
    about = {"why": found.why, "rig_s": found.rig_s, "budget_s": budget_s}
    write_json(about | {"blocks": blocks, "verdict": verdict}, json)


def _targets(until: list[str]) -> dict[tuple[str, str], float]:
    """``effect.parameter=deviation`` texts as a mapping; raises `InputError`."""
    from model.effects.registry import effect

    out = {}
    for one in until:
        name, equals, value = one.partition("=")
        label, dot, q = name.strip().partition(".")
        try:
            size = float(value)
            effect(label).effect.parameter(q)
        except (ValueError, KeyError, StopIteration) as error:
            raise InputError(f"--until {one}: wanted effect.parameter=deviation ({error})") from error
        if not (dot and equals and size > 0.0):
            raise InputError(f"--until {one}: wanted effect.parameter=deviation, as coulomb_friction.mu_up=0.002")
        out[label, q] = size
    return out


def _numbers(text: str, option: str, kind: Any) -> tuple[Any, ...]:
    """Numbers with commas between; raises `InputError`."""
    try:
        found = tuple(kind(part) for part in text.split(",") if part.strip())
    except ValueError as error:
        raise InputError(f"{option} {text}: wanted numbers with commas between, as 1,2,3") from error
    if any(x <= 0 for x in found):
        raise InputError(f"{option} {text}: wanted positive numbers")
    return found


@dataclass(frozen=True)
class Driver:
    """Drives and records blocks of a rig, heeding what a person types or does on the page meanwhile.

    ``scenario`` and ``seed`` are of a simulated rig, which keeps to the clock where it is ``paced``.
    """

    scenario: Path | None = None
    seed: int = 0
    quiet: bool = False
    paced: bool = False
    typed: TypedLines | None = None
    page: Onlookers | None = None

    def __call__(self, block: Chosen, path: Path, number: int) -> Driven:
        """Drive a block into the new recording ``path``; ``number`` are recorded before it."""

        from bench.jobs.blocks import Driven, by_person
        from bench.jobs.run_ramp import make_backend, record
        from rig.execution.operator import StopRequest
        from rig.profile import parse_profile

        profile = parse_profile(block.text, "block")
        backend = make_backend(profile, scenario=self.scenario, seed=self.seed + number, watched=self.paced)
        request = StopRequest(partial(by_person, block))
        with nullcontext() if self.page is None else self.page.of_run(profile, block.text, block.reason) as onlooker:
            done = record(
                profile, block.text, backend, path, extra={"chosen_because": block.reason}, quiet=self.quiet,
                paced=self.paced, onlooker=onlooker, request=request, typed=self.typed,
            )  # fmt: skip
        if done.how == "complete":
            return Driven()
        return Driven(f"{done.how}: {done.why}", request.then if done.asked else None)  # a trip outranks a person


def _asker(typed: TypedLines | None) -> Callable[[Chosen], Chosen | None]:
    """A function that asks a person before a block: the block, one with the person's steps, or None to stop."""
    from bench.jobs.blocks import by_person
    from bench.terminal.run_console import steps_from

    def ask(block: Chosen) -> Chosen | None:
        while True:
            prompt = "Enter: drive it; gammas with commas between: these instead; s: stop"
            answer = typer.prompt(prompt, default="") if typed is None else typed.answer(prompt)
            if answer is None or answer.strip().lower() in ("s", "stop"):
                return None
            try:
                wanted = steps_from(answer)
                return by_person(block, wanted) if wanted.gammas else block
            except InputError as error:
                typer.echo(str(error))

    return ask


def _report(found: Explored, folder: Path, standard_s: float) -> bool:
    """Show the verdict, draw where and why the rig measured, write the report; whether everything could be written."""

    from analysis.report.figures.several import ChosenSteps, draw_choices
    from analysis.report.figures.style import badge_of, save_picture
    from analysis.report.page import write_report
    from bench.jobs.loops import conclude
    from daq.recording import open_recording
    from rig.profile import parse_profile

    if found.loop is None:
        return True
    reasons = tuple(f"block {i}, chosen: {block.reason}" for i, block in enumerate(found.blocks, start=1))
    loop = replace(found.loop, notes=(*found.loop.notes, *reasons))

    def draw() -> None:
        profiles = [parse_profile(block.text) for block in found.blocks]
        steps = [
            ChosenSteps(profile.forcing.ratio, profile.ramp.gammas(), block.seconds, block.reason)
            for profile, block in zip(profiles, found.blocks, strict=True)
        ]
        with open_recording(found.recordings[0]) as opened:
            badge = badge_of(opened)
        save_picture(folder, "choices", badge, lambda figure: draw_choices(steps, standard_s, figure))
        typer.echo(f"choices: {folder / 'choices.png'}")

    writers = (
        ("picture of the choices", draw),
        (
            "report",
            lambda: typer.echo(f"report: {write_report(loop, folder / 'report', recording=found.recordings[0])}"),
        ),
    )
    return conclude(loop, found.recordings, writers)
