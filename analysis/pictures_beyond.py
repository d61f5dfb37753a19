"""Picture of a discovered term: the curve with its band, where the flights lie, and what it says in words.

The rule kept here: the band is drawn wherever the curve is, and the rug shows where there are no data to trust it.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

from analysis.beyond import Discovery
from analysis.pictures import figure

CURVE, BAND, RUG = "#12355b", "#c9d6e3", "#5c677d"


def draw_discovery(found: Discovery, folder: Path, badge: str) -> None:
    """Write ``discovered.png`` and ``.svg`` into ``folder``."""
    x = found.scale * found.knots
    with figure(folder, "discovered", badge, figsize=(6.4, 3.8)) as (_, ax):
        ax.fill_between(x, found.low, found.high, color=BAND, lw=0, label="95 % band")
        ax.plot(x, found.values, "-", lw=1.8, color=CURVE, label="estimate")
        if len(found.seen):
            inside = found.scale * found.seen
            ax.plot(inside, np.full(len(inside), 0.01), "|", ms=7, color=RUG, transform=ax.get_xaxis_transform())
        ax.set_xlabel(f"{found.of}, {found.unit}" if found.unit not in ("", "1") else found.of)
        ax.set_ylabel(f"{found.term}, {found.term_unit}" if found.term_unit not in ("", "1") else found.term)
        ax.set_title("\n".join(textwrap.wrap(found.in_words, 72)), fontsize=9, loc="left")
        ax.legend(frameon=False, fontsize=8)
