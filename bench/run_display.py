"""What an operator sees while a ramp runs: three lines on standard error, drawn anew a few times a second;
on a narrow terminal one line a figure.

The rule kept here: the screen is fed once a block and only draws; nothing waits for it, and no stop goes through it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.run import Status

WIDTH = 80  # characters that the lines need
ALIVE_CYCLES = 3.0  # since the ball last touched the plate or was heard to
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
    console = Console(stderr=True)
    narrow = console.width < WIDTH
    with Live(lines if narrow else Group(bar, lines), console=console, refresh_per_second=4):

        def show(status: Status) -> None:
            done = min(status.sample, status.n_samples)
            bar.update(task, total=status.n_samples, completed=done, description=step_line(status))
            lines.plain = narrow_lines(status) if narrow else f"{health_line(status)}\n{limits_line(status)}"

        yield show


def narrow_lines(status: Status) -> str:
    """The same for a narrow terminal, one figure a line, what must not be missed first."""
    step = f"{step_line(status)}, {min(status.sample / max(status.n_samples, 1), 1.0):.0%}"
    gammas, contact, lost = health_line(status).split("; ")
    return "\n".join([step, lost, contact, *gammas.split(", "), *limits_line(status).split(", ")])


def step_line(status: Status) -> str:
    """Which step, and what it is doing."""
    return f"step {status.step.index + 1}/{status.n_steps}, {status.state.value}"


def health_line(status: Status) -> str:
    """Commanded and achieved gamma, whether the contact lives, samples lost."""
    achieved = "-"
    if math.isfinite(status.achieved_gamma):
        achieved = f"{status.achieved_gamma:.4g} +- {status.achieved_gamma_uncertainty:.1g} (last hold)"
    age = status.contact_age_cycles
    contact = "alive" if age <= ALIVE_CYCLES else f"silent for {age:.0f} cycles"
    return f"gamma {status.step.gamma:.4g}, achieved {achieved}; contact {contact}; {status.lost_samples} samples lost"


def limits_line(status: Status) -> str:
    """How much of each limit is in use."""
    parts = (f"{word} {status.limits_in_use[key]:.0%}" for key, word in LIMITS.items() if key in status.limits_in_use)
    return f"of the limits: {', '.join(parts)}"
