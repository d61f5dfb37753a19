"""Figures of what theory says: forbidden zones, unstable cycles, the plate under a ball, branches of the landing map.

Each zone is followed from gamma to gamma by what it overlaps. Unstable cycles are what no ramp shows, and what a ball
can be held on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from analysis.flights.table import Flights
from analysis.report.figures import style
from analysis.report.figures.style import HARMONICS, MODEL, PLATE, ZONE
from kernels.arrays import Floats
from model.bifurcations.continuation import cycle_branches
from model.bifurcations.forbidden_zones import forbidden_zones
from model.orbits.attractor import Ball, attractor
from model.orbits.exact_ball import ExactBall, IdealBall
from model.orbits.landing_map import LandingMap, branch_of
from model.tones import Forcing, relative_height


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


TURN = 2.0 * math.pi
SHORTEST = 0.05  # flight whose share is compared, in forcing periods: shorter ones are lost in closed contacts
EDGES = np.arange(0.0, 2.6, 0.05)  # of the flight times, forcing periods


def draw_orbit(forcing: Forcing, gamma: float, figure: Figure) -> dict[str, Floats]:
    """Draw plate and ideal ball over four forcing periods; returns periods and both heights, in g/w^2, (n,) each."""
    found = attractor(IdealBall(forcing), gamma)
    periods = np.linspace(0.0, 4.0, 1601)
    n, b, p = forcing.tones.T
    plate = gamma * (b * np.sin(n * TURN * periods[:, None] + p)).sum(axis=1)
    ball, phase = plate.copy(), float(found.phase[0])
    while phase < TURN * periods[-1]:
        for start, tau in zip(found.phase, found.tau, strict=True):
            phase += float((start - phase + 1e-9) % TURN - 1e-9)  # the ball rests until then; 1e-9: or leaves at once
            flown = TURN * periods - phase
            above = (flown >= 0.0) & (flown <= tau)
            ball[above] += relative_height(forcing, gamma, phase, flown[above])
            phase += float(tau)
    figure.set_size_inches(7.0, 3.4)
    ax = figure.subplots()
    ax.plot(periods, plate, color=PLATE, label="plate")
    ax.plot(periods, ball, "--", color=MODEL, label="ball")
    ax.set(xlabel="time (forcing periods)", ylabel="height (g/ω²)", xlim=(0.0, 4.0))
    ax.legend(loc="upper right", fontsize=8)
    return {"periods": periods, "plate": plate, "ball": ball}


def draw_branches(found: LandingMap, flights: Flights, figure: Figure) -> dict[str, Floats]:
    """Draw flight time over take-off phase, the measured return map, and shares; a colour for each branch.

    Returns ``from_periods`` (n,), the lower edges of the bins, and in each the ``predicted_m`` and ``measured_m`` part
    of all flights longer than `SHORTEST` that belong to branch m.
    """
    frequency_hz = np.array([np.nan if p is None else p.frequency_hz for p in flights.plate.steps])
    periods = flights.duration_s * frequency_hz[np.maximum(flights.step, 0)]
    good = flights.good() & (flights.step >= 0) & (periods > SHORTEST)
    good &= np.isfinite(flights.takeoff_phase)
    branch = np.full(len(flights), -1)
    branch[good] = branch_of(flights.takeoff_phase[good], TURN * periods[good])
    share = np.where(found.tau > TURN * SHORTEST, found.share, 0.0)
    share /= share.sum()
    figure.set_size_inches(9.6, 7.2)
    axes = figure.subplot_mosaic([["states", "map"], ["shares", "shares"]])
    table: dict[str, Floats] = {"from_periods": EDGES[:-1]}
    for m, (colour, _, _) in enumerate(HARMONICS[:3]):
        own = found.branch == m
        # states that the motion visits more often than a tenth of the mean stand out
        for rows, size, alpha in ((own, 1.0, 0.25), (own & (share > 0.1 * share.mean()), 3.0, 0.7)):
            axes["states"].plot(
                found.phase[rows] / TURN, found.tau[rows] / TURN, ".", ms=size, mew=0, color=colour, alpha=alpha,
                rasterized=True,
            )  # fmt: skip
        first = np.flatnonzero((branch[:-1] == m) & good[1:] & (np.diff(flights.step) == 0))
        axes["map"].plot(periods[first], periods[first + 1], ".", ms=2.5, mew=0, color=colour, rasterized=True)
        table[f"predicted_{m}"] = np.histogram(found.tau[own] / TURN, EDGES, weights=share[own])[0]
        table[f"measured_{m}"] = np.histogram(periods[branch == m], EDGES)[0] / good.sum()
        words = f"branch {m}: {share[own].sum():.0%} predicted, {np.sum(branch == m) / good.sum():.0%} measured"
        axes["shares"].stairs(table[f"predicted_{m}"], EDGES, color=colour, lw=1.6, label=words)
        axes["shares"].stairs(table[f"measured_{m}"], EDGES, color=colour, fill=True, alpha=0.3)
    axes["states"].set(xlabel="take-off phase (periods)", ylabel="flight time (periods)", xlim=(0.0, 1.0))
    axes["map"].set(xlabel="flight time (periods)", ylabel="the next one", xlim=(0.0, 2.6), ylim=(0.0, 2.6))
    axes["shares"].set(xlabel="flight time (periods)", ylabel="share of the flights", xlim=(0.0, 2.6))
    axes["shares"].legend(fontsize=8, frameon=False)
    return table
