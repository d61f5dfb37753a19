"""What theory adds to a bifurcation diagram: forbidden zones as areas, unstable cycles as lines.

Each zone is followed from gamma to gamma by what it overlaps.
Unstable cycles are what no ramp shows, and what a ball can be held on.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from analysis.report.figures import style
from analysis.report.figures.style import ZONE
from kernels.arrays import Floats
from model.bifurcations.continuation import cycle_branches
from model.bifurcations.forbidden_zones import forbidden_zones
from model.orbits.attractor import Ball
from model.orbits.exact_ball import ExactBall
from model.tones import Forcing


def zones_over(forcing: Forcing, gammas: Floats) -> list[Floats]:
    """Zones between ascending ``gammas``: rows of gamma, lower and upper edge in radians, (n, 3) each.

    Between two gammas the place where a zone begins or ends is looked for.
    """
    growing: list[list[tuple[float, float, float]]] = []
    done: list[list[tuple[float, float, float]]] = []
    for gamma in gammas:
        still = []
        for a, b in forbidden_zones(forcing, float(gamma)):
            mine = next((z for z in growing if z[-1][1] < b and a < z[-1][2]), None)
            if mine is None:
                mine = []
            else:
                growing.remove(mine)
            mine.append((float(gamma), float(a), float(b)))
            still.append(mine)
        done += growing
        growing = still
    step = float(gammas[1] - gammas[0])
    seen = [np.array(zone) for zone in done + growing]
    return [
        np.vstack(
            [
                *_onward(forcing, zone[0], max(zone[0, 0] - step, gammas[0]))[::-1],
                zone,
                *_onward(forcing, zone[-1], min(zone[-1, 0] + step, gammas[-1])),
            ]
        )
        for zone in seen
    ]


def _onward(forcing: Forcing, last: Floats, beyond: float) -> list[Floats]:
    """Rows of a zone after its ``last`` one, towards the gamma ``beyond``, where the zone is no more."""
    rows: list[Floats] = []
    # a zone's end to a 32nd of a step of gamma
    for _ in range(5 if beyond != last[0] else 0):
        gamma = 0.5 * (last[0] + beyond)
        here = [(a, b) for a, b in forbidden_zones(forcing, gamma) if a < last[2] and last[1] < b]
        if here:
            last = np.array([gamma, *here[0]])
            rows.append(last)
        else:
            beyond = gamma
    return rows


def draw_zones(ax: Any, zones: list[Floats], scale: float, unit: float, label: str | None) -> None:
    """Shade the zones; gamma is drawn ``scale`` times, a flight time ``unit`` times as large."""
    for i, zone in enumerate(zones):
        g, a, b = zone.T
        ax.fill_between(g * scale, a * unit, b * unit, color=ZONE, lw=0, zorder=0, label=label if i == 0 else None)


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
