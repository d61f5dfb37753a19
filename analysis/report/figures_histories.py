"""Figure of the flight-time history: every flight of the run in order of time, over the model's cycle of each step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.flights.compare import Comparison
from analysis.flights.table import FlightFlag, Flights
from analysis.report import style
from analysis.report.gamma import gamma_scale
from daq.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_LEVELS = 12  # flight times of a predicted cycle that are drawn as lines


def draw_history(recording: Recording, flights: Flights, compared: Comparison, figure: Figure) -> None:
    """Flight times against time in the run, the predicted cycle of each step as lines, steps named by gamma."""
    shown = (flights.step >= 0) & ~flights.has(FlightFlag.FALSE | FlightFlag.CUT | FlightFlag.GAP)
    if not shown.any():
        return
    figure.set_size_inches(8.0, 3.8)
    ax = figure.subplots()
    scale = gamma_scale(recording.setup.forcing, flights.plate.ratio)
    _draw_levels(ax, recording, compared)
    settling = shown & flights.has(FlightFlag.SETTLING)
    doubtful = shown & ~settling & flights.has(FlightFlag.DOUBLE_HIT | FlightFlag.UNSURE)
    for rows, mark, size, colour, words in (
        (shown & ~settling & ~doubtful, "o", 2.6, style.MEASURED, "measured"),
        (doubtful, "x", 3.6, style.DOUBTFUL, "measured: double hit, or unsure"),
        (settling, "+", 3.6, style.FLOOR, "while a step settles"),
    ):
        if rows.any():
            (line,) = ax.plot(
                flights.takeoff_s[rows], 1e3 * flights.duration_s[rows], mark, ms=size, color=colour, label=words,
                mew=0 if mark == "o" else 0.8,
            )  # fmt: skip
            style.name_flights(line, np.flatnonzero(rows))
    ax.set(xlabel="time in the run (s)", ylabel="flight time (ms)")
    ax.set_ylim(0.0, 1.08 * float(1e3 * flights.duration_s[shown].max()))
    _name_steps(ax, recording, flights, scale.factor, scale.symbol)
    ax.legend(loc="lower right", fontsize=8, framealpha=0.9, ncols=2)


def _draw_levels(ax: Any, recording: Recording, compared: Comparison) -> None:
    """The predicted flight times of each step that has a cycle, over its hold."""
    label: str | None = "model's cycle"
    for own in compared.steps:
        levels = np.unique(own.predicted_s)
        if not own.periodic or not 0 < len(levels) <= MOST_LEVELS:
            continue
        row = recording.steps[own.step]
        ends = (row["first_sample"] + np.array([row["settle_samples"], row["n_samples"]])) / recording.rate_hz
        ax.hlines(1e3 * levels, *ends, color=style.MODEL, lw=2.6, alpha=0.8, zorder=0, label=label)
        label = None


def _name_steps(ax: Any, recording: Recording, flights: Flights, factor: float, symbol: str) -> None:
    """Steps on a second axis above, by their gamma, not more of them than have room."""
    plates = [p for p in flights.plate.steps if p is not None and p.gamma > 0]
    top = ax.secondary_xaxis("top")
    every = max(1, -(-len(plates) // 12))
    chosen = plates[::every]
    first = recording.steps["first_sample"] / recording.rate_hz
    for t in first:
        ax.axvline(float(t), color="0.85", lw=0.6, zorder=-1)
    top.set_xticks([float(first[p.step]) for p in chosen], [f"{factor * p.gamma:.3f}" for p in chosen], fontsize=7)
    top.set_xlabel(f"{symbol} of the step that begins", fontsize=8)
