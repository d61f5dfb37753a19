"""Figure of a discovered term: the curve with its band, the range of the flights, and its description."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from analysis.discovery.discover import Discovery
from analysis.report.style import AFTER, BAND, PLATE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_discovery(found: Discovery, figure: Figure) -> None:
    """The curve with its 95 % band, over a rug of the flights."""
    figure.set_size_inches(6.4, 3.8)
    ax = figure.subplots()
    x = found.scale * found.knots
    ax.fill_between(x, found.low, found.high, color=BAND, lw=0, label="95 % band")
    ax.plot(x, found.values, "-", lw=1.8, color=AFTER, label="estimate")
    inside = found.scale * found.seen
    inside = inside[(inside >= x[0]) & (inside <= x[-1])]
    ax.plot(
        inside,
        np.full(len(inside), 0.015),
        "|",
        ms=7,
        color=PLATE,
        alpha=0.5,
        transform=ax.get_xaxis_transform(),
        label="flights (how far they go)",
    )
    ax.set_xlabel(f"{found.covariate}, {found.unit}" if found.unit not in ("", "1") else found.covariate)
    name = "force on the ball (positive: up)" if found.term == "force" else found.term
    unit = found.term_unit.replace("^2", "\u00b2")
    ax.set_ylabel(f"{name}, {unit}" if unit not in ("", "1") else name)
    ax.set_title("\n".join(textwrap.wrap(found.description.replace("^2", "\u00b2"), 72)), fontsize=9, loc="left")
    ax.legend(frameon=False, fontsize=8)
