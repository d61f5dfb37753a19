"""Figure of a joint verdict: what was named, and what differs, run by run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.joint.result import JointVerdict, OverRuns, RunOutcome
from analysis.loop.parameters import Z95
from analysis.report.figures.style import BAND, MEASURED, MODEL, badge_text, save_picture
from analysis.report.wording import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_ROWS = 6  # parameters in the figure
ROW_INCHES, HEAD_INCHES = 1.35, 0.6


def draw_runs(found: JointVerdict, figure: Figure) -> None:
    """Each run's own value with its 95 % interval, over the day, and the mean of all runs with its interval.

    What was named comes first, then what differs between runs.
    """
    shown = [x for x in found.parameters if x.kind == "effect" or x.differs]
    shown = [x for x in shown if np.isfinite(x.sigmas).any()][:MOST_ROWS]
    if not shown:
        return
    figure.set_size_inches(7.2, HEAD_INCHES + ROW_INCHES * len(shown))
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for ax, x in zip(axes, shown, strict=True):
        _draw_one(ax, x, found.runs)
    axes[-1].set_xlabel("days since the first run" if found.dated else "run")


def write_pictures(found: JointVerdict, folder: Path, *, simulated: bool) -> Path:
    """Save the figure into ``folder`` as ``runs.png`` and ``runs.svg``; raises `InputError` where it cannot be."""
    badge = badge_text(f"{len(found.runs)} runs", simulated=simulated)
    save_picture(folder, "runs", badge, lambda figure: draw_runs(found, figure))
    return folder / "runs.png"


def _draw_one(ax: Any, x: OverRuns, runs: Sequence[RunOutcome]) -> None:
    days = np.array([run.days for run in runs])
    known = np.isfinite(x.sigmas)
    values, sigmas = np.array(x.values)[known], np.array(x.sigmas)[known]
    ax.axhspan(x.value - Z95 * x.sigma, x.value + Z95 * x.sigma, color=BAND, lw=0)
    ax.axhline(x.value, color=MODEL, lw=1.0)
    ax.errorbar(days[known], values, Z95 * sigmas, fmt="o", ms=3.5, lw=0.9, color=MEASURED)
    words = "differs between runs" if x.differs else "one value for all runs"
    if x.one_run is not None:
        words = f"different in one run: {Path(runs[x.one_run.place].recording).name}"
    ax.set_title(f"{plain(x.effect)}: {plain(x.parameter)}, {words}", fontsize=9, loc="left")
    ax.set_ylabel(x.unit if x.unit != "1" else "relative")
