"""Flights of a recording under a progress bar, and every picture of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from analysis.flights.assemble import Flights, flights_of
from analysis.flights.compare import Comparison
from daq.recording import Recording


def flights_with_progress(opened: Recording, *, quiet: bool) -> Flights:
    """The flights, with a bar on standard error while the file is read."""
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as progress:
        task = progress.add_task(f"reading {opened.path.name}", total=1.0)
        return flights_of(opened, progress=lambda part: progress.update(task, completed=part))


def draw(opened: Recording, table: Flights, folder: Path, held: Comparison | None = None) -> None:
    """Every picture of a recording, into ``folder``; ``held`` is its comparison with the declared model, if known."""
    from analysis.report.figures.measured import measured
    from analysis.report.figures.recording import FIGURES
    from analysis.report.figures.style import badge_of, save_picture

    badge = badge_of(opened)
    shown = measured(opened, table, held)
    for figure in FIGURES:
        save_picture(folder, figure.name, badge, partial(figure.draw, shown))
