"""Figures of the model: plate and ball of a cycle, and branches of the landing map with their measured flights."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from analysis.flights.table import Flights
from analysis.report.figures.style import HARMONICS, MODEL, PLATE
from kernels.arrays import Floats
from model.orbits.attractor import attractor
from model.orbits.exact_ball import IdealBall
from model.orbits.landing_map import LandingMap, branch_of
from model.tones import Forcing, relative_height

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
