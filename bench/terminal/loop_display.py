"""Terminal display of a closed loop, a stake and runs judged together, and the writing of outputs one by one."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence

from rich.console import Console
from rich.table import Table

from analysis.explore.stake import Outcome
from analysis.joint.result import JointVerdict, OverRuns
from analysis.loop.result import ClosedLoop
from analysis.loop.verdict import short_verdict
from analysis.report import wording
from analysis.report.wording import microseconds, plus_minus
from bench.terminal.console import new_table, print_lines, print_table
from daq.setup.errors import InputError
from daq.setup.setup import Stake
from model.effects.registry import unit_of


def show(loop: ClosedLoop) -> None:
    """Print verdict, errors before and after, and the course of the search."""
    out = Console(highlight=False, markup=False)  # [drive] is a table of the profile
    out.print(f"\nverdict: {wording.verdict_line(loop)}", style="bold", soft_wrap=True)
    for line in wording.why_this_verdict(loop):
        out.print(f"  {line}", soft_wrap=True)
    for line in wording.discovered_in_words(loop):
        out.print(f"  {line}", soft_wrap=True)
    if loop.selection.rejected is not None:
        out.print(f"  {wording.rejected_in_words(loop)}", soft_wrap=True)
    others = wording.others_in_words(loop)
    if others:
        out.print(f"  the data cannot tell this from: {'; '.join(others)}", soft_wrap=True)
    b, a = loop.errors.before, loop.errors.after
    table = Table("held-out steps", "before", "after", "noise floor")
    for name, before, after, floor in (
        ("landing, rms (us)", b.landing_rms_us, a.landing_rms_us, microseconds(loop.errors.landing_floor_us)),
        ("landing, robust (us)", b.landing_nmad_us, a.landing_nmad_us, ""),
        ("take-off, robust (us)", b.takeoff_nmad_us, a.takeoff_nmad_us, microseconds(loop.errors.takeoff_floor_us)),
    ):
        table.add_row(name, microseconds(before), microseconds(after), floor)
    table.add_row("flight time (%)", f"{100 * b.flight_time_relative:.3f}", f"{100 * a.flight_time_relative:.3f}", "")
    out.print(table)
    for line in (*loop.selection.rounds, *wording.moved_calibrations(loop), *loop.notes):
        out.print(f"  {line}", soft_wrap=True)


def show_stake(stake: Stake, outcome: Outcome) -> None:
    """Print what came of a stake: its steps, and what they say."""
    named, rival = (" + ".join(names) or "the declared model" for names in (stake.named, stake.rival))
    table = new_table("gamma", "found\n(us)", "predicted\n(us)", "by the rival\n(us)", "landings", "")
    for s in outcome.steps:
        table.add_row(
            f"{s.staked.gamma:g}", f"{s.median_us:.1f}", f"0 +- {s.half_us:.1f}",
            "elsewhere" if s.staked.rival_us is None else f"{s.staked.rival_us:.1f}",
            str(s.landings), "met" if s.met else "missed",
        )  # fmt: skip
    print_table(table)
    print_lines(
        f"median of measured minus predicted landings, one flight ahead; the rival is {rival}",
        f"rms over noise and parameters' uncertainty: flights {outcome.flights:.2f}, plate {outcome.plate:.2f}",
        f"{named}: {outcome.words}",
    )


def write_outputs(outputs: Sequence[tuple[str, Callable[[], object]]]) -> bool:
    """Whether each output was written by its function; one that fails is reported and does not stop the others."""
    complete = True
    for name, write in outputs:
        try:
            write()
        except (InputError, OSError) as error:
            complete = False
            sys.stderr.write(f"error: the {name} could not be written: {error}\n")
    return complete


def show_runs(found: JointVerdict) -> None:
    """Print the verdict, what the runs share, what belongs to each, and the course of the search."""
    out = Console(highlight=False, markup=False)
    names = f": {' + '.join(found.names)}" if found.names else ""
    out.print(
        f"\nverdict on {len(found.runs)} runs: {short_verdict(found.verdict)}{names}", style="bold", soft_wrap=True
    )
    for run in found.odd:
        out.print(f"  {run.recording} is not explained ({', '.join(run.failed)})", soft_wrap=True)
    for x in found.parameters:
        if (rest := x.one_run) is None:
            continue
        own, run = plus_minus(x.values[rest.place], x.sigmas[rest.place]), found.runs[rest.place]
        others = plus_minus(rest.others, rest.others_sigma)
        words = f"different in one run: {run.recording} has {own}, all others together {others} (unit {x.unit})"
        out.print(f"  {x.effect}.{x.parameter} is {words}", soft_wrap=True)
    if len(found.ties) > 1:
        others = "; ".join(" + ".join(names) for names in found.ties[1:])
        out.print(f"  the runs cannot tell this from: {others}", soft_wrap=True)
    table = Table("parameter", "unit", "all runs", "from run to run", "constant, p", "trend a day, p", "")
    for x in found.parameters:
        if x.kind == "effect" or any(map(math.isfinite, x.sigmas)):
            table.add_row(*_row(x))
    out.print(table)
    for error in found.systematics:
        if error.sigma_us < 0.9 * error.prior_us:
            out.print(
                f"  {error.name} in all runs: {error.value_us:.1f} +- {error.sigma_us:.1f} us "
                f"(beforehand 0 +- {error.prior_us:.1f})", soft_wrap=True,
            )  # fmt: skip
    runs = Table(
        "run", "started" if found.dated else "number", "flights", "rms of residuals", "landing (us)", "floor (us)"
    )
    for run in found.runs:
        when = run.started if found.dated else f"{run.days:.0f}"
        runs.add_row(
            run.recording, when, str(run.flights), f"{run.ratio:.2f}",
            microseconds(run.landing_rms_us), microseconds(run.noise_floor_us),
        )  # fmt: skip
    out.print(runs)
    limits = (
        f"{effect}.{parameter} {size:.2g} {unit_of(effect, parameter)}".rstrip()
        for (effect, _, parameter), size in ((name.partition("."), size) for name, size in found.detection.items())
    )
    if found.detection:
        out.print(f"  all runs together could not have shown less than: {'; '.join(limits)}", soft_wrap=True)
    for line in found.rounds:
        out.print(f"  {line}", soft_wrap=True)


def _row(x: OverRuns) -> tuple[str, ...]:
    test = x.constancy
    trend = f"{test.slope:.2g}, {test.p_trend:.2g}" if math.isfinite(test.slope_sigma) else "-"
    return (
        f"{x.effect}.{x.parameter}", x.unit, plus_minus(x.value, x.sigma), f"{x.spread:.2g}",
        f"{test.p:.2g}" if test.degrees else "-", trend, "differs" if x.differs else "",
    )  # fmt: skip
