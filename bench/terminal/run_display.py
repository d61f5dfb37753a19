"""The display during a ramp: three lines on standard error, drawn a few times a second.

A narrow terminal has one line a figure. The screen is fed once a block and only draws; nothing waits for it, and no
stop goes through it. A terminal that is gone (closed, or a dropped connection) costs the run nothing, as standard error
is a stream that may go away (`bench.terminal.streams.SafeStream`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rig.programme.sequencer import State

if TYPE_CHECKING:
    from rig.execution.operator import Status

LIMITS = {
    "drive_v": "drive", "plate_mps2": "acceleration", "velocity_mps": "velocity", "displacement_m": "displacement",
}  # fmt: skip


@contextmanager
def run_display(quiet: bool) -> Iterator[Callable[[Status], None]]:
    """A bar, the step with its gammas and the state of contact and samples, and the part used of each limit."""
    from rich.console import Console, Group
    from rich.live import Live
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    if quiet:
        yield lambda status: None
        return
    bar = Progress(TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    task = bar.add_task("", total=None)
    lines = Text(overflow="fold")
    screen = Console(stderr=True)
    narrow = screen.width < 80
    with Live(lines if narrow else Group(bar, lines), console=screen, refresh_per_second=4) as live:

        def show(status: Status) -> None:
            done = status.n_samples - status.left_samples
            bar.update(task, total=status.n_samples, completed=done, description=step_line(status))
            lines.plain = narrow_lines(status) if narrow else f"{health_line(status)}\n{limits_line(status)}"
            if (status.state is State.PAUSED) is live.is_started:
                live.stop() if live.is_started else live.start()  # while it holds, nothing is drawn over what is typed

        yield show
    if not screen.is_terminal:
        screen.line()  # a terminal's cursor is left on a new line; in a log, what follows would go on in the same


def narrow_lines(status: Status) -> str:
    """The same for a narrow terminal, one figure a line, what must not be missed first."""
    step = f"{step_line(status)}, {1.0 - status.left_samples / max(status.n_samples, 1):.0%}"
    gammas, contact, lost = health_line(status).split("; ")
    return "\n".join([step, lost, contact, *gammas.split(", "), *limits_line(status).split(", ")])


def step_line(status: Status) -> str:
    """The step, counted from 0 as in every table, and its state."""
    return f"step {status.step.index} (last {status.n_steps - 1}), {status.state.value}"


def health_line(status: Status) -> str:
    """Commanded and achieved gamma, whether the contact lives, samples lost."""
    achieved = "-"
    if math.isfinite(status.achieved_gamma):  # one digit of the uncertainty: the line has 80 characters
        achieved = f"{status.achieved_gamma:.4g} +- {status.achieved_gamma_uncertainty:.1g} (last hold)"
    age = status.contact_age_cycles
    contact = "alive" if age <= 3.0 else f"silent for {age:.0f} cycles"
    return f"gamma {status.step.gamma:.4g}, achieved {achieved}; contact {contact}; {status.lost_samples} samples lost"


def limits_line(status: Status) -> str:
    """The part of each limit in use."""
    parts = (f"{word} {status.limits_in_use[key]:.0%}" for key, word in LIMITS.items() if key in status.limits_in_use)
    return f"of the limits: {', '.join(parts)}"
