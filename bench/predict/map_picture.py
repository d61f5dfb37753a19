"""A map over gamma and one more parameter: the period of the attractor reached from rest at each point.

A picture of fewer dots than points shows every n-th point: a mean of periods has no meaning.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from analysis.report.figures import style
from analysis.report.gamma import GAMMA_LABEL
from kernels.arrays import Integers
from model.surveys.ensemble import Job

DOTS = 1600  # of the picture along each axis, at most
PERIODS = (1, 2, 3, 4, 6, 8, 12, 16, 32, 64)  # lower bounds of the colours
CHAOTIC, AT_REST = -1, 0
NAMES = {"restitution.e0": "restitution e", "coulomb_friction.mu": "friction μ"}


def map_picture(path: Path, job: Job, picture: Path) -> None:
    """Draw the map that is kept in ``path``: colour is the period in forcing periods, grey is chaos, white is rest."""
    rows, columns = job.shape
    step = -(-max(rows, columns) // DOTS)
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
        bar.set_ticklabels(["chaotic", "at rest", *_labels()])
        ax.set_title(
            f"c = {job.ratio}: {columns} x {rows} points" + (f", one of {step} x {step} shown" if step > 1 else "")
        )
        figure.savefig(picture, dpi=200)


def _periods(file: h5py.File, start: int, stop: int, step: int) -> Integers:
    some = slice(start, stop, step)
    flights, kind = file["flights"][some], file["kind"][some]
    period = np.minimum(file["period"][some], PERIODS[-1])
    return np.where(kind == 2, CHAOTIC, np.where(flights == 0, AT_REST, period))


def _labels() -> list[str]:
    ends = [*(b - 1 for b in PERIODS[1:]), None]
    return [
        f"{a}" if b == a else f"{a} and more" if b is None else f"{a} to {b}"
        for a, b in zip(PERIODS, ends, strict=True)
    ]
