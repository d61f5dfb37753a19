"""Residuals of each channel against what might cause them, as a person would look for the cause.

The rule kept here: before and after stand one above the other on one horizontal axis, each on the linear scale that its
own size asks for; the noise floor is a grey band, and a line through the medians shows what the eye should follow.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.loop.close_loop import ClosedLoop
from analysis.report.gamma import gamma_scale
from analysis.report.style import AFTER, BEFORE, FLOOR, clipped_dots, figure
from analysis.residuals.covariates import COVARIATES, covariates
from analysis.residuals.forward_model import Values
from analysis.residuals.plate_observables import GAIN, KINDS, PHASE

Array = NDArray[np.float64]

LANDINGS = (
    "gamma", "flight_s", "height_m", "takeoff_phase_rad", "launch_mps", "plate_speed_at_takeoff_mps",
    "impact_mps", "previous_flight_s", "time_in_run_s",
)  # fmt: skip
TAKEOFFS = ("gamma", "dwell_s", "previous_impact_mps", "takeoff_phase_rad", "previous_flight_s", "time_in_run_s")
COLUMNS = 3
BINS, LEAST_IN_BIN = 12, 4
SHOWN = 95.0  # per cent of the residuals within the axes; the rest stands at their edge, as triangles
AT_LEAST_FLOORS = 4.0
PAPER = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}  # under a number in a panel
STILL = 1e-6  # relative spread of a covariate below which it has nothing to say
TICKS = (-1000, -100, -10, -2, 0, 2, 10, 100, 1000)


def draw_landings(loop: ClosedLoop, folder: Path, badge: str) -> None:
    """Landing residuals, before and after, against nine covariates."""
    ev = loop.world.evidence
    before, after = (_of(loop, v, "landing_s") for v in _points(loop))
    _draw(loop, folder, badge, "residuals", "landing", LANDINGS, ev.scored, before, after, loop.noise_floor_us)


def draw_takeoffs(loop: ClosedLoop, folder: Path, badge: str) -> None:
    """Take-off residuals, before and after, against six covariates; nothing where no take-off was seen."""
    before, after = (_of(loop, v, "opening_s") for v in _points(loop))
    rows, floor = loop.world.from_rest, loop.takeoff_floor_us
    _draw(loop, folder, badge, "takeoffs", "take-off", TAKEOFFS, rows, before, after, floor)


def _points(loop: ClosedLoop) -> tuple[Values, Values]:
    return loop.attribution.before.fitted.values, loop.best.fitted.values


def _of(loop: ClosedLoop, values: Values, which: str) -> Array:
    return np.asarray(1e6 * getattr(loop.world.residuals(values), which))


def _draw(
    loop: ClosedLoop,
    folder: Path,
    badge: str,
    name: str,
    event: str,
    against: tuple[str, ...],
    rows: NDArray[np.bool_],
    before: Array,
    after: Array,
    floor_us: float,
) -> None:
    """Blocks of three covariates: the row of residuals before over the row after (alone where nothing was added)."""
    if not rows.any():
        return
    x = covariates(loop.world, loop.best.fitted.values)
    shown = gamma_scale(loop.world.evidence.setup.forcing, loop.world.evidence.steps.ratio)
    against = tuple(c for c in against if np.nanstd(x[c][rows]) > STILL * np.nanmax(np.abs(x[c][rows]), initial=0.0))
    if not against:
        return
    sides = [("declared model", after, AFTER)]
    if loop.best is not loop.attribution.before:
        sides = [("before", before, BEFORE), ("after", after, AFTER)]
    blocks = -(-len(against) // COLUMNS)
    size = (9.6, 1.75 * blocks * len(sides) + 0.9)
    with figure(
        folder, name, badge, nrows=blocks * len(sides), ncols=COLUMNS, figsize=size, sharey="row", squeeze=False
    ) as (_, axes):
        for i, covariate in enumerate(against):
            about = COVARIATES[covariate]
            values = (shown.factor if covariate == "gamma" else about.scale) * x[covariate][rows]
            column = axes[len(sides) * (i // COLUMNS) : len(sides) * (i // COLUMNS + 1), i % COLUMNS]
            for ax, (side, residual, colour) in zip(column, sides, strict=True):
                _panel(ax, values, residual[rows], colour, floor_us)
                if i % COLUMNS == 0:
                    ax.set_ylabel(f"{side}, $\\mu$s", color=colour)
            for ax in column[:-1]:
                ax.sharex(column[-1])
                ax.tick_params(labelbottom=False)
            words = rf"${shown.symbol}$" if covariate == "gamma" else about.words
            column[-1].set_xlabel(f"{words}, {about.unit}" if about.unit else words)
        for i in range(len(against), COLUMNS * blocks):
            for ax in axes[len(sides) * (i // COLUMNS) : len(sides) * (i // COLUMNS + 1), i % COLUMNS]:
                ax.set_axis_off()
        axes[0, 0].set_title(f"{event}: measured minus predicted", loc="left", fontsize=10)


def _panel(ax: Any, x: Array, residual_us: Array, colour: str, floor_us: float) -> None:
    """One covariate: residuals (triangles: beyond the axis), medians of equal shares, the noise floor."""
    known = np.isfinite(x) & np.isfinite(residual_us)
    x, y = x[known], residual_us[known]
    if not len(x):
        return
    floor = floor_us if np.isfinite(floor_us) else 0.0
    limit = 1.15 * max(float(np.percentile(np.abs(y), SHOWN)), AT_LEAST_FLOORS * floor, 1e-3)
    ax.axhspan(-floor, floor, color=FLOOR, alpha=0.35, lw=0)
    ax.axhline(0.0, color=FLOOR, lw=0.6)
    beyond = clipped_dots(ax, x, y, limit, color=colour)
    if beyond:
        place = {"xycoords": "axes fraction", "ha": "right", "bbox": PAPER}
        ax.annotate(f"{beyond} beyond", (0.98, 0.04), fontsize=6.5, color=colour, **place)
    middle, median = medians(x, y)
    ax.plot(middle, np.clip(median, -limit, limit), "-", lw=1.1, color="black", alpha=0.75)
    ax.set_ylim(-limit, limit)


def medians(x: Array, y: Array) -> tuple[Array, Array]:
    """Medians of ``x`` and ``y`` in bins of about equal count, ordered; bins of one value are one point."""
    cuts = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
    place = np.clip(np.searchsorted(cuts, x, side="right") - 1, 0, max(len(cuts) - 2, 0))
    chosen = [place == k for k in range(max(len(cuts) - 1, 1)) if np.sum(place == k) >= LEAST_IN_BIN]
    middle = np.array([np.median(x[c]) for c in chosen])
    return middle, np.array([np.median(y[c]) for c in chosen])


def draw_plate(loop: ClosedLoop, folder: Path, badge: str) -> None:
    """The plate against the drive: gain and phase over gamma, and every datum in standard deviations."""
    ev = loop.world.evidence
    data = ev.plate
    if not len(data):
        return
    scale = gamma_scale(ev.setup.forcing, ev.steps.ratio)
    gamma = scale.factor * ev.steps.gamma[data.step]
    before, after = (loop.world.residuals(v).plate for v in _points(loop))
    sides = [(before, BEFORE, "o", "before"), (after, AFTER, ".", "after")]
    if loop.best is loop.attribution.before:
        sides = [(after, AFTER, ".", "declared model")]
    with figure(folder, "plate", badge, ncols=3, figsize=(9.6, 3.2), width_ratios=(1, 1, 1.25)) as (_, axes):
        shown = ((GAIN, 100.0, "plate over drive, gain, %"), (PHASE, 180.0 / np.pi, "phase, degrees"))
        for ax, (kind, per, words) in zip(axes, shown, strict=False):
            rows = data.kind == kind
            for residual, colour, mark, side in sides:
                ax.errorbar(
                    gamma[rows],
                    per * residual[rows],
                    per * data.sigma[rows],
                    fmt=mark,
                    ms=4,
                    mfc="none",
                    lw=0.8,
                    color=colour,
                    label=side,
                )
            ax.axhline(0.0, color=FLOOR, lw=0.6)
            ax.set(xlabel=rf"${scale.symbol}$", ylabel=words)
            if not rows.any():
                ax.text(0.5, 0.5, "the drive's scale is not known", ha="center", transform=ax.transAxes, fontsize=8)
        present = [k for k in range(len(KINDS)) if np.any(data.kind == k)]
        for residual, colour, *_ in sides:
            for at, kind in enumerate(present):
                z = (residual / data.sigma)[data.kind == kind]
                spread = at if len(sides) == 1 else at + (0.16 if colour == AFTER else -0.16)
                axes[2].plot(z, np.full(len(z), spread), "|", ms=7, color=colour)
        axes[2].axvspan(-2.0, 2.0, color=FLOOR, alpha=0.35, lw=0)
        largest = max(float(np.max(np.abs(residual / data.sigma))) for residual, *_ in sides)
        axes[2].set_xscale("symlog", linthresh=4.0)
        ticks = [t for t in TICKS if abs(t) <= max(largest, 2.0)]
        axes[2].set_xticks(ticks, [str(t) for t in ticks])
        axes[2].set_yticks(range(len(present)), [KINDS[k] for k in present])
        axes[2].set_xlabel("each datum, in sigmas")
        axes[0].legend(frameon=False, fontsize=8)
