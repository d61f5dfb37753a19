"""Figure of a run that chose its own steps: where it measured, when, and why."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.report.figures.style import BAND, HARMONICS, INK

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ChosenSteps:
    """A block of steps: c, gammas in the order of the run, rig time, and the reason in words."""

    ratio: int
    gammas: tuple[float, ...]
    seconds: float
    reason: str


def draw_choices(blocks: Sequence[ChosenSteps], standard_s: float, figure: Figure) -> None:
    """Gamma of every step over rig time, in units of the gamma of take-off; below, each block's reason.

    ``standard_s`` is the rig time of the profile's own ramp.
    """
    lines = [f"{i}. {line}" for i, b in enumerate(blocks, start=1) for line in [b.reason]]
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
