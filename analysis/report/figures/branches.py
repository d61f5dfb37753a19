"""Unstable cycles in a bifurcation diagram: what no ramp shows, and what a ball can be held on."""

from __future__ import annotations

from typing import Any

import numpy as np

from analysis.report.figures import style
from model.bifurcations.cycle_branches import cycle_branches
from model.orbits.attractor import Ball
from model.orbits.exact_ball import ExactBall


def draw_unstable(ax: Any, ball: Ball, low: float, high: float, scale: float, unit: float) -> None:
    """Flight times of the unstable cycles of one and two flights between two gammas, as fine dashed lines.

    ``scale`` and ``unit`` are those of the axes, to a gamma and to a flight time. Nothing is drawn for a ball that the
    exact kernels do not fly, since its cycles take minutes.
    """
    if not isinstance(ball, ExactBall):
        return
    label: str | None = "unstable cycle, predicted"
    for branch in cycle_branches(ball, low, high):
        unstable = np.where(np.abs(branch.multiplier) > 1.0, 1.0, np.nan)
        if np.isfinite(unstable).any():
            y = branch.tau * (unit * unstable)[:, None]
            lines = ax.plot(branch.gamma * scale, y, "--", lw=0.9, color=style.EVENT, zorder=1)
            lines[0].set_label(label)
            label = None
