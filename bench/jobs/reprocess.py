"""Flights of a recording under a progress bar, and every picture of them."""

from __future__ import annotations

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
    from analysis.report.figures.style import badge_of, save_picture
    from analysis.report.figures.table import figures_of

    badge = badge_of(opened)
    for figure, drawn in figures_of(measured(opened, table, held)):
        save_picture(folder, figure.name, badge, drawn)
