"""Figures of the closed loop: landing errors, candidates, a discovered term, residuals; and the table of all.

Before is the pale colour and after the dark one, in the same units on the same axis; the noise floor is drawn wherever
an error is. Decision 316. Residuals against a covariate stand one above the other, each on a linear scale of its own;
a line connects the medians of bins.
"""

from __future__ import annotations

import textwrap
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from analysis.loop.result import ClosedLoop, Predictions
from analysis.report.figures import style
from analysis.report.figures.style import AFTER, BEFORE, FLOOR, Figure
from analysis.report.narrative import gains
from analysis.report.wording import gamma_scale, plain
from analysis.residuals.covariates import COVARIATES
from analysis.residuals.plate_data.plate_observables import GAIN, KINDS, PHASE
from analysis.statistics import mad_sigma
from kernels.arrays import Floats, Integers

LANDINGS = (
    "gamma", "flight_s", "height_m", "takeoff_phase_rad", "launch_mps", "plate_speed_at_takeoff_mps",
    "impact_mps", "previous_flight_s", "time_in_run_s",
)  # fmt: skip
TAKEOFFS = ("gamma", "dwell_s", "previous_impact_mps", "takeoff_phase_rad", "previous_flight_s", "time_in_run_s")
COLUMNS = 3  # of panels
PAPER = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}  # under a number in a panel


def sides(loop: ClosedLoop) -> list[tuple[str, Predictions, str]]:
    """Label, predictions and colour of each model to show: before and after, or only the declared one."""
    if not loop.selection.names:
        return [("declared model", loop.flights.after, AFTER)]
    return [("before", loop.flights.before, BEFORE), ("after", loop.flights.after, AFTER)]


def draw_residuals(event: str, loop: ClosedLoop, figure: Canvas) -> None:
    """Residuals of landings or take-offs, before and after, against covariates; nothing where none was seen.

    Blocks of three covariates: the row of residuals before over the row after (one where nothing was added).
    """
    x, flights, landing = loop.flights.covariates, loop.flights, event == "landing"
    against: tuple[str, ...] = LANDINGS if landing else TAKEOFFS
    rows = flights.scored if landing else flights.from_rest
    floor_us = loop.errors.landing_floor_us if landing else loop.errors.takeoff_floor_us
    shown = gamma_scale(loop.setup.forcing, loop.steps.ratio)
    if rows.any():
        # a covariate that spreads by less than 1e-6 of itself counts as constant
        against = tuple(c for c in against if np.nanstd(x[c][rows]) > 1e-6 * np.nanmax(np.abs(x[c][rows]), initial=0.0))
    if not rows.any() or not against:
        return
    shown_sides, residual = sides(loop), f"{event.replace('-', '')}_residual_s"
    blocks = -(-len(against) // COLUMNS)
    figure.set_size_inches(9.6, 1.75 * blocks * len(shown_sides) + 0.9)
    axes = figure.subplots(blocks * len(shown_sides), COLUMNS, sharey="row", squeeze=False)
    for i, covariate in enumerate(against):
        about = COVARIATES[covariate]
        values = (shown.factor if covariate == "gamma" else about.scale) * x[covariate][rows]
        column = axes[len(shown_sides) * (i // COLUMNS) : len(shown_sides) * (i // COLUMNS + 1), i % COLUMNS]
        for ax, (side, predicted, colour) in zip(column, shown_sides, strict=True):
            _panel(ax, values, 1e6 * getattr(predicted, residual)[rows], np.flatnonzero(rows), colour, floor_us)
            if i % COLUMNS == 0:
                ax.set_ylabel(f"{side}, µs", color=colour)
        for ax in column[:-1]:
            ax.sharex(column[-1])
            ax.tick_params(labelbottom=False)
        column[-1].locator_params(axis="x", nbins=5)  # labels as 0.0015 stand side by side
        name = shown.symbol if covariate == "gamma" else about.words
        column[-1].set_xlabel(f"{name}, {about.unit}" if about.unit else name)
    for i in range(len(against), COLUMNS * blocks):
        for ax in axes[len(shown_sides) * (i // COLUMNS) : len(shown_sides) * (i // COLUMNS + 1), i % COLUMNS]:
            ax.set_axis_off()
    axes[0, 0].set_title(f"{event}: measured minus predicted", loc="left", fontsize=10)


def _panel(ax: Any, x: Floats, residual_us: Floats, flights: Integers, colour: str, floor_us: float) -> None:
    """One covariate: residuals (triangles: beyond the axis), medians of equal shares, the noise floor."""
    known = np.isfinite(x) & np.isfinite(residual_us)
    x, y = x[known], residual_us[known]
    if not len(x):
        return
    floor = floor_us if np.isfinite(floor_us) else 0.0
    # 95 % of the residuals within the axes, and four noise floors; the others are triangles at the edge
    limit = 1.15 * max(float(np.percentile(np.abs(y), 95.0)), 4.0 * floor, 1e-3)
    ax.axhspan(-floor, floor, color=FLOOR, alpha=0.35, lw=0)
    ax.axhline(0.0, color=FLOOR, lw=0.6)
    beyond = style.clipped_dots(ax, x, y, limit, flights[known], color=colour)
    if beyond:
        place = {"xycoords": "axes fraction", "ha": "right", "bbox": PAPER}
        ax.annotate(f"{beyond} beyond", (0.98, 0.04), fontsize=6.5, color=colour, **place)
    middle, median = medians(x, y)
    ax.plot(middle, np.clip(median, -limit, limit), "-", lw=1.1, color="black", alpha=0.75)
    ax.set_ylim(-limit, limit)


def medians(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Medians of ``x`` and ``y`` in 12 bins of about equal count, ordered; bins of one value are one point."""
    cuts = np.unique(np.quantile(x, np.linspace(0.0, 1.0, 13)))
    place = np.clip(np.searchsorted(cuts, x, side="right") - 1, 0, max(len(cuts) - 2, 0))
    chosen = [place == k for k in range(max(len(cuts) - 1, 1)) if np.sum(place == k) >= 4]
    middle = np.array([np.median(x[c]) for c in chosen])
    return middle, np.array([np.median(y[c]) for c in chosen])


def draw_plate_residuals(loop: ClosedLoop, figure: Canvas) -> None:
    """The plate against the drive: gain and phase over gamma, and every datum in standard deviations."""
    data = loop.plate
    if not len(data):
        return
    figure.set_size_inches(9.6, 3.2)
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 1.25))
    scale = gamma_scale(loop.setup.forcing, loop.steps.ratio)
    gamma = scale.factor * loop.steps.gamma[data.step]
    models = [(data.before, BEFORE, "o", "before"), (data.after, AFTER, ".", "after")]
    if not loop.selection.names:
        models = [(data.after, AFTER, ".", "declared model")]
    shown = ((GAIN, 100.0, "plate over drive, gain, %"), (PHASE, 180.0 / np.pi, "phase, degrees"))
    for ax, (kind, per, quantity) in zip(axes, shown, strict=False):
        rows = data.kind == kind
        for residual, colour, mark, side in models:
            y, error = per * residual[rows], per * data.sigma[rows]
            ax.errorbar(gamma[rows], y, error, fmt=mark, ms=4, mfc="none", lw=0.8, color=colour, label=side)
        ax.axhline(0.0, color=FLOOR, lw=0.6)
        ax.set(xlabel=scale.symbol, ylabel=quantity)
        if not rows.any():
            ax.text(0.5, 0.5, "the drive's scale is not known", ha="center", transform=ax.transAxes, fontsize=8)
    axes[0].legend(frameon=False, fontsize=8)
    ax, present = axes[2], [k for k in range(len(KINDS)) if np.any(data.kind == k)]  # a row for each kind
    for residual, colour, *_ in models:
        for at, kind in enumerate(present):
            z = (residual / data.sigma)[data.kind == kind]
            height = at if len(models) == 1 else at + (0.16 if colour == AFTER else -0.16)
            ax.plot(z, np.full(len(z), height), "|", ms=7, color=colour)
    ax.axvspan(-2.0, 2.0, color=FLOOR, alpha=0.35, lw=0)
    largest = max(float(np.max(np.abs(residual / data.sigma))) for residual, *_ in models)
    ax.set_xscale("symlog", linthresh=4.0)
    ticks = [t for t in (-1000, -100, -10, -2, 0, 2, 10, 100, 1000) if abs(t) <= max(largest, 2.0)]
    ax.set_xticks(ticks, [str(t).replace("-", "−") for t in ticks])
    ax.set_yticks(range(len(present)), [KINDS[k] for k in present])
    ax.set_xlabel("each datum, in sigmas")


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
    style.plain_decades(ax.yaxis)
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
        (~accepted & ~refused, style.NEUTRAL, "", "others"),
    ):
        if which.any():
            ax.barh(
                at[which], gain[which], xerr=error[which], color=colour, ecolor=style.ERROR_BAR, capsize=2,
                hatch=hatch, edgecolor=AFTER if hatch else "none", label=label,
            )  # fmt: skip
    for place, (_, (g, e)) in zip(at, rows, strict=True):
        if not g > 0.0:
            ax.annotate("none", (e, float(place)), (6, 0), textcoords="offset points", va="center", fontsize=7)
    least, sigmas = loop.limits.first_effect_nats, loop.limits.first_effect_sigmas
    needed = f"needed: {least:g} nats, {sigmas:g} standard errors, and more than chance"
    ax.axvline(least, color=BEFORE, lw=1.2, ls="--", label=needed)
    ax.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.0, ncols=4)
    ax.set_yticks(at, [name for name, _ in rows])
    ax.set_xscale("symlog", linthresh=10.0)
    style.plain_decades(ax.xaxis)
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
    ax.fill_between(x, found.curve.low, found.curve.high, color=style.BAND, lw=0, label="95 % band")
    ax.plot(x, found.curve.values, "-", lw=1.8, color=AFTER, label="estimate")
    if found.form is not None:
        ax.plot(
            x, found.form.at(found.curve.knots), "--", lw=1.2, color=style.IMPROVED, label=f"formula: {found.form.name}"
        )
    inside = found.covariate.scale * found.seen
    inside = inside[(inside >= x[0]) & (inside <= x[-1])]
    ax.plot(
        inside, np.full(len(inside), 0.015), "|", ms=7, color=style.PLATE, alpha=0.5,
        transform=ax.get_xaxis_transform(), label="flights (how far they go)",
    )  # fmt: skip
    name = "force on the ball (positive: up)" if found.term == "force" else found.term
    about = ((found.covariate.words, found.covariate.unit), (name, found.curve.unit.replace("^2", "\u00b2")))
    x_label, y_label = (f"{what}, {unit}" if unit not in ("", "1") else what for what, unit in about)
    ax.set(xlabel=x_label, ylabel=y_label)
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
        "residuals", partial(draw_residuals, "landing"), "residuals",
        "Landings: measured minus predicted, against what might cause them.",
    ),
    Figure(
        "takeoffs", partial(draw_residuals, "take-off"), "residuals",
        "Take-offs: measured minus predicted, against what might cause them.",
    ),
    Figure(
        "plate_residuals", draw_plate_residuals, "residuals",
        "The plate against the drive as the model predicts it, before and after.",
    ),
)  # fmt: skip
