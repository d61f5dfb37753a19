"""Flights of a recording under a progress bar, and every picture of them."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from analysis.flights.assemble import Flights, flights_of
from analysis.flights.compare import Comparison, compare
from daq.recording import Recording


def flights_with_progress(opened: Recording, *, quiet: bool) -> Flights:
    """The flights, with a bar on standard error while the file is read."""
    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as progress:
        task = progress.add_task(f"reading {opened.path.name}", total=1.0)
        return flights_of(opened, progress=lambda part: progress.update(task, completed=part))


def draw(opened: Recording, table: Flights, folder: Path, held: Comparison | None = None) -> None:
    """Every picture of a recording, into ``folder``; ``held`` is its comparison with the declared model, if known."""
    from analysis.report.figures_flights import draw_bifurcations, draw_return_maps, draw_trajectory
    from analysis.report.figures_plate import draw_plate  # matplotlib is slow to import
    from analysis.report.style import badge_of, save_picture

    badge = badge_of(opened)
    save_picture(folder, "plate", badge, lambda figure: draw_plate(opened, table, figure))
    if len(table):
        held = held or compare(table, opened.setup, steps_table=opened.steps)
        save_picture(folder, "bifurcation", badge, lambda figure: draw_bifurcations(opened, table, figure))
        save_picture(folder, "trajectory", badge, lambda figure: draw_trajectory(opened, table, figure))
        save_picture(folder, "return_maps", badge, lambda figure: draw_return_maps(opened, table, held, figure))
