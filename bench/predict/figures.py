"""Pictures of `bench predict`: diagrams with their forbidden zones, and maps of periods.

An axis says which gamma it shows, and whether a time is in seconds or in forcing periods.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import h5py
import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from analysis.report.figures import style
from analysis.report.figures.theory import draw_unstable, draw_zones, zones_over
from analysis.report.wording import GAMMA_LABEL, PEAK_LABEL
from bench.predict.request import Request, ball_for
from daq.setup.errors import InputError
from kernels.arrays import Integers
from model.bifurcations.events import bifurcations
from model.orbits.exact_ball import IdealBall
from model.surveys.diagram import Rows
from model.surveys.ensemble import Job
from model.tones import Forcing

PERIODS = (1, 2, 3, 4, 6, 8, 12, 16, 32, 64)  # lower bounds of the colours
NAMES = {"restitution.e0": "restitution e", "coulomb_friction.mu": "friction μ"}
STYLE: dict[Any, Any] = style.STYLE | {"xtick.top": True, "savefig.dpi": 200}


def diagram_picture(rows: Rows, forcing: Forcing, request: Request, path: Path) -> None:
    """Draw one diagram; the forbidden zones are those of the ideal ball and are drawn for it only."""
    ideal = not request.effects and not request.sweep
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 4.4), layout="constrained")
        ax = figure.subplots()
        draw_diagram(ax, rows, forcing, request.ratio, request.frequency_hz, ideal=ideal)
        if request.branches:
            scale, unit = axes_units(forcing, request.ratio, request.frequency_hz)
            draw_unstable(ax, ball_for(request), float(rows.gamma[0]), float(rows.gamma[-1]), scale, unit)
            ax.legend(loc="lower right", fontsize=9, facecolor="white", edgecolor="none", framealpha=0.9)
        if request.effects:
            ax.set_title(", ".join(request.effects), fontsize=9)
        if request.sweep:
            ax.set_title(f"gamma swept {request.sweep}", fontsize=9, loc="right")
        try:
            figure.savefig(path)
        except (OSError, ValueError) as error:
            text = f"cannot write the picture {path}: {error}; give a name ending in .png, .pdf or .svg"
            raise InputError(text) from error


def axes_units(forcing: Forcing, ratio: int, frequency_hz: float | None) -> tuple[float, float]:
    """What the axes of a diagram show for gamma 1, and for a flight time of 1 / w."""
    scale = 2.0 if ratio == 1 and forcing.amplitude == (2.0,) else 1.0
    return scale, 1.0 / (2.0 * math.pi * (frequency_hz or 1.0))


def draw_diagram(ax: Any, rows: Rows, forcing: Forcing, ratio: int, frequency_hz: float | None, *, ideal: bool) -> None:
    """One diagram: flight times against gamma (gamma_peak at c = 1), zones shaded, the large events marked."""
    scale, unit = axes_units(forcing, ratio, frequency_hz)
    x = np.repeat(rows.gamma, rows.tau.shape[1]) * scale
    y = rows.tau.ravel() * unit
    shown = np.isfinite(y)
    crowd = np.repeat((rows.kind == 2) | (rows.flights > 8), rows.tau.shape[1])
    low, high = float(rows.gamma[0]), float(rows.gamma[-1])
    if ideal:
        zones = [z for z in zones_over(forcing, np.linspace(low, high, 400)) if len(z) > 3]
        draw_zones(ax, zones, scale, unit, "forbidden")
        if zones:
            ax.legend(loc="lower right", fontsize=9, facecolor="white", edgecolor="none", framealpha=0.9)
        _marks(ax, forcing, low, high, scale)
    ax.plot(x[shown & crowd], y[shown & crowd], ".", ms=0.6, mew=0, color=style.INK, alpha=0.5, rasterized=True)
    ax.plot(x[shown & ~crowd], y[shown & ~crowd], ".", ms=1.8, mew=0, color=style.INK, rasterized=True)
    top = float(np.nanmax(y)) if shown.any() else 1.0
    ax.set_xlim(low * scale, high * scale)
    ax.set_ylim(0.0, 1.05 * top)
    ax.set_xlabel(f"{PEAK_LABEL if scale == 2.0 else GAMMA_LABEL}   (c = {ratio})")
    if frequency_hz:
        ax.set_ylabel(f"flight time (s) at {frequency_hz:g} Hz")
        ax.secondary_yaxis("right", functions=(lambda t: t * frequency_hz, lambda n: n / frequency_hz)).set_ylabel(
            "forcing periods"
        )
    else:
        ax.set_ylabel("flight time (forcing periods)")


def _marks(ax: Any, forcing: Forcing, low: float, high: float, scale: float) -> None:
    """The events of windows wide enough to be seen, as fine lines with their names."""
    wide = (high - low) / 60.0
    kinds = {"take-off": "take-off", "new take-off window": "2nd window", "lock": "lock", "period doubling": "doubling"}
    last = -math.inf
    for event in bifurcations(IdealBall(forcing), low, high, narrowest=wide):
        if event.type in kinds and (event.before.flights or 0) <= 1:
            ax.axvline(event.gamma * scale, color=style.EVENT, lw=0.6, ls=(0, (4, 3)), zorder=0)
            if event.gamma - last > (high - low) / 40.0:
                ax.text(
                    event.gamma * scale, 0.985, f" {kinds[event.type]}", rotation=90, va="top", ha="left", fontsize=7,
                    color=style.EVENT, transform=ax.get_xaxis_transform(),
                )  # fmt: skip
            last = event.gamma


def map_picture(path: Path, job: Job, picture: Path) -> None:
    """Draw the map of ``job``, whose points are in the file ``path``: the period of the attractor reached from rest.

    Grey is chaos, white is rest. A picture of fewer dots than points shows every n-th: a mean of periods says nothing.
    """
    rows, columns = job.shape
    # more dots than a screen shows would only make the file large
    step = -(-max(rows, columns) // 1600)
    with h5py.File(path, "r") as file:
        period = np.array([_periods(file, i * columns, (i + 1) * columns, step) for i in range(0, rows, step)])
    axis, gammas = job.axes[0], job.gammas
    with matplotlib.rc_context(style.STYLE):
        figure = Figure(figsize=(8.0, 6.0), layout="constrained")
        ax = figure.subplots()
        colours = colormaps["viridis"](np.linspace(0.0, 1.0, len(PERIODS)))
        shades = ListedColormap(["0.6", "white", *colours])
        norm = BoundaryNorm([-1.5, -0.5, *(p - 0.5 for p in PERIODS), 2 * PERIODS[-1]], shades.N)
        extent = (gammas[0], gammas[-1], axis.values[0], axis.values[-1])
        shown = ax.imshow(
            period, origin="lower", aspect="auto", extent=extent, cmap=shades, norm=norm, interpolation="nearest"
        )
        ax.set_xlabel(GAMMA_LABEL)
        ax.set_ylabel(NAMES.get(axis.name, axis.name))
        bar = figure.colorbar(
            shown, ax=ax, spacing="uniform", label="period of the attractor from rest, forcing periods"
        )
        edges = norm.boundaries
        bar.set_ticks(0.5 * (edges[:-1] + edges[1:]))
        last = [f"{PERIODS[-1]} and more"]
        labels = [f"{a}" if b == a + 1 else f"{a} to {b - 1}" for a, b in itertools.pairwise(PERIODS)] + last
        bar.set_ticklabels(["chaotic", "at rest", *labels])
        ax.set_title(
            f"c = {job.ratio}: {columns} x {rows} points" + (f", one of {step} x {step} shown" if step > 1 else "")
        )
        figure.savefig(picture, dpi=200)


def _periods(file: h5py.File, start: int, stop: int, step: int) -> Integers:
    some = slice(start, stop, step)
    flights, kind = file["flights"][some], file["kind"][some]
    period = np.minimum(file["period"][some], PERIODS[-1])
    return np.where(kind == 2, -1, np.where(flights == 0, 0, period))  # -1: chaotic, 0: at rest
