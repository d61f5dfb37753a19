"""Terminal display of a closed loop, and the writing of its outputs one by one."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from analysis.loop.result import ClosedLoop
from analysis.report.narrative import why_this_verdict
from analysis.report.numbers import microseconds
from analysis.report.wording import form_in_words, moved_calibrations, others_in_words, rejected_in_words, verdict_line
from daq.setup.errors import InputError


def show(loop: ClosedLoop) -> None:
    """Print verdict, errors before and after, and the course of the search."""
    from rich.console import Console
    from rich.table import Table

    out = Console(highlight=False)
    out.print(f"\nverdict: {verdict_line(loop)}", style="bold", soft_wrap=True)
    for line in why_this_verdict(loop):
        out.print(f"  {line}", soft_wrap=True)
    if loop.discovered is not None:
        out.print(f"  discovered: {loop.discovered.description}", soft_wrap=True)
        if form := form_in_words(loop.discovered):
            out.print(f"  {form}", soft_wrap=True, markup=False)
    if loop.selection.rejected is not None:
        out.print(f"  {rejected_in_words(loop)}", soft_wrap=True)
    others = others_in_words(loop)
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
    for line in (*loop.selection.rounds, *moved_calibrations(loop), *loop.notes):
        out.print(f"  {line}", soft_wrap=True)


def write_outputs(outputs: Sequence[tuple[str, Callable[[], object]]]) -> bool:
    """Write each output by its function; one that fails is reported under its name and does not stop the others.

    Returns
    -------
    bool
        Whether all were written.
    """
    complete = True
    for name, write in outputs:
        try:
            write()
        except (InputError, OSError, ValueError) as error:
            complete = False
            sys.stderr.write(f"error: the {name} could not be written: {error}\n")
    return complete
