"""Figures of the closed loop: landing errors step by step, candidates, a discovered term; and the table of all.

Before is the pale colour and after the dark one, in the same units on the same axis; the noise floor is drawn wherever
an error is. Decision 316.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.loop.result import ClosedLoop
from analysis.report.figures.residuals import draw_landings, draw_plate_residuals, draw_takeoffs, sides
from analysis.report.figures.style import (
    AFTER,
    BAND,
    BEFORE,
    ERROR_BAR,
    FLOOR,
    IMPROVED,
    NEUTRAL,
    PLATE,
    Figure,
    plain_decades,
)
from analysis.report.gamma import gamma_scale
from analysis.report.narrative import gains
from analysis.report.wording import plain
from analysis.statistics import mad_sigma
from kernels.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


def draw_errors(loop: ClosedLoop, figure: Canvas) -> None:
    """Robust landing error of each step, before and after, over gamma, with the noise floor and the held-out steps."""
    figure.set_size_inches(7.2, 3.6)
    ax = figure.subplots()
    shown = gamma_scale(loop.setup.forcing, loop.steps.ratio)
    gamma, held = shown.factor * loop.steps.gamma, loop.steps.held_out
    floor = by_step(loop, loop.flights.after.landing_sigma_s, lambda x: np.sqrt(np.mean(x**2)))
    ax.semilogy(gamma, floor, "_", ms=11, mew=2.0, color=FLOOR, label="noise floor")
    for name, side, colour in sides(loop):
        error = by_step(loop, side.landing_residual_s, mad_sigma)
        mark: dict[str, Any] = (
            {"mfc": "none", "marker": "s", "ms": 6.5} if colour == BEFORE else {"marker": "o", "ms": 4}
        )
        ax.semilogy(gamma[~held], error[~held], ls="", color=colour, label=name, **mark)
        size = 8 if colour == BEFORE else 5
        ax.semilogy(
            gamma[held], error[held], "D", ms=size, mfc="none", mew=1.5, color=colour, label=f"{name}, held out"
        )
    plain_decades(ax.yaxis)
    ax.set_xlabel(shown.label)
    ax.set_ylabel("landing error (robust), µs")
    ax.legend(frameon=False, fontsize=8, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def by_step(loop: ClosedLoop, x: Floats, summary: Any) -> Floats:
    """A summary of ``x`` (n,) over the scored flights of each step, in microseconds; NaN where there are none, (m,)."""
    flights = loop.flights
    known = flights.scored & np.isfinite(x)
    rows = [known & (flights.step == s) for s in range(len(loop.steps))]
    return np.array([1e6 * summary(x[r]) if r.any() else np.nan for r in rows])


def draw_candidates(loop: ClosedLoop, figure: Canvas) -> None:
    """Held-out gain of every candidate of the first round with its standard error, and the gain required."""
    # more candidates have no room in the figure
    rows = list(gains(loop).items())[:16][::-1]
    if not rows:
        return
    figure.set_size_inches(7.2, 1.1 + 0.26 * len(rows))
    ax = figure.subplots()
    chosen = {plain(n) for n in loop.selection.names}
    rejected = {plain(n) for n in loop.selection.rejected.names} if loop.selection.rejected else set()
    at, parts = np.arange(len(rows)), [set(name.split(" + ")) for name, _ in rows]
    accepted, refused = np.array([bool(p & chosen) for p in parts]), np.array([p == rejected for p in parts])
    gain = np.array([max(g, 0.0) for _, (g, _) in rows])
    error = np.array([e for _, (_, e) in rows])
    for which, colour, hatch, label in (
        (accepted, AFTER, "", "added"),
        (refused & ~accepted, "white", "////", "best rejected"),
        (~accepted & ~refused, NEUTRAL, "", "others"),
    ):
        if which.any():
            ax.barh(
                at[which],
                gain[which],
                xerr=error[which],
                color=colour,
                ecolor=ERROR_BAR,
                capsize=2,
                hatch=hatch,
                edgecolor=AFTER if hatch else "none",
                label=label,
            )
    for place, (_, (g, e)) in zip(at, rows, strict=True):
        if not g > 0.0:
            ax.annotate("none", (e, float(place)), (6, 0), textcoords="offset points", va="center", fontsize=7)
    least, sigmas = loop.limits.first_effect_nats, loop.limits.first_effect_sigmas
    needed = f"needed: {least:g} nats, {sigmas:g} standard errors, and more than chance"
    ax.axvline(least, color=BEFORE, lw=1.2, ls="--", label=needed)
    ax.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.0, ncols=4)
    ax.set_yticks(at, [name for name, _ in rows])
    ax.set_xscale("symlog", linthresh=10.0)
    plain_decades(ax.xaxis)
    ax.set_xlim(left=0.0)
    ax.set_xlabel("gain on held-out steps of one effect added, nats")


def draw_discovery(loop: ClosedLoop, figure: Canvas) -> None:
    """Draw the discovered curve with its 95 % band, over a rug of the flights; nothing where none was discovered."""
    found = loop.discovered
    if found is None:
        return
    figure.set_size_inches(6.4, 3.8)
    ax = figure.subplots()
    x = found.covariate.scale * found.curve.knots
    ax.fill_between(x, found.curve.low, found.curve.high, color=BAND, lw=0, label="95 % band")
    ax.plot(x, found.curve.values, "-", lw=1.8, color=AFTER, label="estimate")
    if found.form is not None:
        ax.plot(x, found.form.at(found.curve.knots), "--", lw=1.2, color=IMPROVED, label=f"formula: {found.form.name}")
    inside = found.covariate.scale * found.seen
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
    ax.set_xlabel(
        f"{found.covariate.words}, {found.covariate.unit}"
        if found.covariate.unit not in ("", "1")
        else found.covariate.words
    )
    name = "force on the ball (positive: up)" if found.term == "force" else found.term
    unit = found.curve.unit.replace("^2", "\u00b2")
    ax.set_ylabel(f"{name}, {unit}" if unit not in ("", "1") else name)
    ax.set_title("\n".join(textwrap.wrap(found.description.replace("^2", "\u00b2"), 72)), fontsize=9, loc="left")
    ax.legend(frameon=False, fontsize=8)


FIGURES = (
    Figure(
        "errors", draw_errors, "errors",
        "Landing error of each step (robust), before (open squares) and after (dots), with the noise floor. Diamonds: "
        "held-out steps.",
    ),
    Figure(
        "candidates", draw_candidates, "why",
        "Candidates added one at a time: gain on steps not fitted, with its standard error. Hatched: rejected.",
    ),
    Figure(
        "discovered", draw_discovery, "why",
        "What was discovered beyond the named effects, with its 95 % band.",
    ),
    Figure(
        "residuals", draw_landings, "residuals",
        "Landings: measured minus predicted, against what might cause them.",
    ),
    Figure(
        "takeoffs", draw_takeoffs, "residuals",
        "Take-offs: measured minus predicted, against what might cause them.",
    ),
    Figure(
        "plate_residuals", draw_plate_residuals, "residuals",
        "The plate against the drive as the model predicts it, before and after.",
    ),
)  # fmt: skip
