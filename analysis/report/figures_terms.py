"""Picture of a discovered term: the curve with its band, where the flights lie, and what it says in words.

The rule kept here: the band is drawn wherever the curve is, and the rug shows where there are no data to trust it.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

from analysis.discovery.discover import Discovery
from analysis.report.style import AFTER, PLATE, figure

CURVE, BAND, RUG = AFTER, "#c9d6e3", PLATE


def draw_discovery(found: Discovery, folder: Path, badge: str) -> None:
    """Write ``discovered.png`` and ``.svg`` into ``folder``."""
    x = found.scale * found.knots
    with figure(folder, "discovered", badge, figsize=(6.4, 3.8)) as (_, ax):
        ax.fill_between(x, found.low, found.high, color=BAND, lw=0, label="95 % band")
        ax.plot(x, found.values, "-", lw=1.8, color=CURVE, label="estimate")
        inside = found.scale * found.seen
        inside = inside[(inside >= x[0]) & (inside <= x[-1])]
        rug = {"transform": ax.get_xaxis_transform(), "label": "flights (how far they go)"}
        ax.plot(inside, np.full(len(inside), 0.015), "|", ms=7, color=RUG, alpha=0.5, **rug)
        ax.set_xlabel(f"{found.of}, {found.unit}" if found.unit not in ("", "1") else found.of)
        name = "force on the ball (positive: up)" if found.term == "force" else found.term
        unit = found.term_unit.replace("^2", "\u00b2")
        ax.set_ylabel(f"{name}, {unit}" if unit not in ("", "1") else name)
        ax.set_title("\n".join(textwrap.wrap(found.in_words.replace("^2", "\u00b2"), 72)), fontsize=9, loc="left")
        ax.legend(frameon=False, fontsize=8)
