"""Figures of several recordings: a joint verdict run by run, and the blocks of a run that chose its own steps."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from analysis.joint.result import JointVerdict
from analysis.report.figures.style import BAND, HARMONICS, INK, MEASURED, MODEL, badge_text, save_picture
from analysis.report.wording import plain
from analysis.statistics import Z95


def draw_runs(found: JointVerdict, figure: Figure) -> None:
    """Each run's own value with its 95 % interval, over the day, and the mean of all runs with its interval.

    What was named comes first, then what differs between runs.
    """
    shown = [x for x in found.parameters if x.kind == "effect" or x.differs]
    shown = [x for x in shown if np.isfinite(x.sigmas).any()][:6]
    if not shown:
        return
    figure.set_size_inches(7.2, 0.6 + 1.35 * len(shown))
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for ax, x in zip(axes, shown, strict=True):
        days = np.array([run.days for run in found.runs])
        known = np.isfinite(x.sigmas)
        values, sigmas = np.array(x.values)[known], np.array(x.sigmas)[known]
        ax.axhspan(x.value - Z95 * x.sigma, x.value + Z95 * x.sigma, color=BAND, lw=0)
        ax.axhline(x.value, color=MODEL, lw=1.0)
        ax.errorbar(days[known], values, Z95 * sigmas, fmt="o", ms=3.5, lw=0.9, color=MEASURED)
        words = "differs between runs" if x.differs else "one value for all runs"
        if x.one_run is not None:
            words = f"different in one run: {Path(found.runs[x.one_run.place].recording).name}"
        ax.set_title(f"{plain(x.effect)}: {plain(x.parameter)}, {words}", fontsize=9, loc="left")
        ax.set_ylabel(x.unit if x.unit != "1" else "relative")
    axes[-1].set_xlabel("days since the first run" if found.dated else "run")


def write_pictures(found: JointVerdict, folder: Path, *, simulated: bool) -> Path:
    """Save the figure into ``folder`` as ``runs.png`` and ``runs.svg``; raises `InputError` where it cannot be."""
    badge = badge_text(f"{len(found.runs)} runs", simulated=simulated)
    save_picture(folder, "runs", badge, lambda figure: draw_runs(found, figure))
    return folder / "runs.png"


class ChosenSteps(NamedTuple):
    """A block of steps: c, gammas in the order of the run, rig time, and the reason in words."""

    ratio: int
    gammas: tuple[float, ...]
    seconds: float
    reason: str


def draw_choices(blocks: Sequence[ChosenSteps], standard_s: float, figure: Figure) -> None:
    """Gamma of every step over rig time, in units of the gamma of take-off; below, each block's reason.

    ``standard_s`` is the rig time of the profile's own ramp.
    """
    lines = [f"{i}. {block.reason}" for i, block in enumerate(blocks, start=1)]
    wrapped = [part for line in lines for part in textwrap.wrap(line, 104, subsequent_indent="    ")]
    figure.set_size_inches(7.2, 3.4 + 0.17 * len(wrapped))
    ax, words = figure.subplots(2, 1, height_ratios=[3.4, max(0.17 * len(wrapped), 0.2)])
    start, shown = 0.0, set[int]()
    for i, block in enumerate(blocks, start=1):
        takeoff = 0.5 if block.ratio == 1 else 1.0 / (1.0 + block.ratio**2)
        n = len(block.gammas)
        times = start + block.seconds * (np.arange(n) + 0.5) / n
        colour, mark, _ = HARMONICS[(block.ratio - 1) % len(HARMONICS)]
        label = None if block.ratio in shown else f"c = {block.ratio}"
        shown.add(block.ratio)
        if i % 2:
            ax.axvspan(start, start + block.seconds, color=BAND, alpha=0.5, lw=0)
        ax.plot(times, np.array(block.gammas) / takeoff, mark, ms=6, color=colour, label=label)
        middle = start + 0.5 * block.seconds
        ax.annotate(str(i), (middle, 1.0), xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=9)
        start += block.seconds
    ax.axvline(standard_s, color=INK, lw=1.0, ls=":", label="end of the profile's own ramp")
    ax.set_xlim(0.0, 1.04 * max(standard_s, start))
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("rig time, s")
    ax.set_ylabel("gamma over that of take-off")
    ax.legend(frameon=False, fontsize=8, ncol=4, loc="lower left", bbox_to_anchor=(0.0, 1.05), borderaxespad=0.0)
    words.axis("off")
    words.text(0.0, 1.0, "\n".join(wrapped), fontsize=7.5, va="top", transform=words.transAxes, parse_math=False)
