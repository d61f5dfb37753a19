"""Figures of the closed loop: errors step by step, candidates compared.

The rule kept here: before is always the pale colour and after the dark one, in the same units on the same axis, and the
noise floor is drawn wherever an error is.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.loop.close_loop import ClosedLoop
from analysis.report.gamma import gamma_scale
from analysis.report.narrative import gains
from analysis.report.style import AFTER, BEFORE, FLOOR, figure
from analysis.report.wording import plain
from analysis.statistics import mad_sigma

Array = NDArray[np.float64]

RULED = "#adb5bd"


def draw_errors(loop: ClosedLoop, folder: Path, badge: str) -> None:
    """Robust landing error of each step, before and after, over gamma, with the noise floor and the held-out steps."""
    world = loop.world
    ev = world.evidence
    before = world.residuals(loop.attribution.before.fitted.values)
    after = world.residuals(loop.best.fitted.values)
    total = world.uncertainty(loop.best.fitted.values).landing_total_s
    m = len(ev.steps)

    def per_step(x: Array) -> Array:
        out = np.full(m, np.nan)
        for s in range(m):
            rows = ev.scored & (ev.measured.step == s) & np.isfinite(x)
            if rows.any():
                out[s] = 1e6 * mad_sigma(x[rows])
        return out

    floor = np.array(
        [
            1e6 * np.sqrt(np.mean(total[r] ** 2)) if (r := ev.scored & (ev.measured.step == s)).any() else np.nan
            for s in range(m)
        ]
    )
    shown = gamma_scale(ev.setup.forcing, ev.steps.ratio)
    gamma = shown.factor * ev.steps.gamma
    held = np.isin(np.arange(m), np.flatnonzero(_held(loop)))
    with figure(folder, "errors", badge, figsize=(7.2, 3.6)) as (_, ax):
        ax.semilogy(gamma, floor, "_", ms=11, mew=2.0, color=FLOOR, label="noise floor")
        sides = [(per_step(after.landing_s), AFTER, "declared model")]
        if loop.best is not loop.attribution.before:
            sides = [(per_step(before.landing_s), BEFORE, "before"), (per_step(after.landing_s), AFTER, "after")]
        for x, colour, name in sides:
            ax.semilogy(gamma[~held], x[~held], "o", ms=4, color=colour, label=name)
            ax.semilogy(gamma[held], x[held], "D", ms=6, mfc="none", mew=1.5, color=colour, label=f"{name}, held out")
        ax.set_xlabel(shown.label)
        ax.set_ylabel(r"landing error (robust), $\mu$s")
        ax.legend(frameon=False, fontsize=8, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _held(loop: ClosedLoop) -> NDArray[np.bool_]:
    return ~loop.best.fitted.fitter.train


def draw_candidates(loop: ClosedLoop, folder: Path, badge: str) -> None:
    """Held-out gain of every candidate of the first round with its standard error, and what a gain must exceed."""
    rows = list(gains(loop).items())[:16][::-1]
    if not rows:
        return
    chosen, rejected = ({plain(n) for n in x.names} if x else set() for x in (loop.best, loop.rejected))
    with figure(folder, "candidates", badge, figsize=(7.2, 1.1 + 0.26 * len(rows))) as (_, ax):
        at = np.arange(len(rows))
        parts = [set(name.split(" + ")) for name, _ in rows]
        accepted, refused = np.array([bool(p & chosen) for p in parts]), np.array([p == rejected for p in parts])
        gain = np.array([max(g, 0.0) for _, (g, _) in rows])
        error = np.array([e for _, (_, e) in rows])
        for which, colour, hatch, words in (
            (accepted, AFTER, "", "added"),
            (refused & ~accepted, "white", "////", "best rejected"),
            (~accepted & ~refused, RULED, "", "others"),
        ):
            if which.any():
                ax.barh(
                    at[which],
                    gain[which],
                    xerr=error[which],
                    color=colour,
                    ecolor="#495057",
                    capsize=2,
                    hatch=hatch,
                    edgecolor=AFTER if hatch else "none",
                    label=words,
                )
        for place, (_, (g, e)) in zip(at, rows, strict=True):
            if not g > 0.0:
                ax.annotate("none", (e, float(place)), (6, 0), textcoords="offset points", va="center", fontsize=7)
        needed = f"needed: {loop.limits.gain_nats:g} nats and {loop.limits.gain_sigmas:g} standard errors"
        ax.axvline(loop.limits.gain_nats, color=BEFORE, lw=1.2, ls="--", label=needed)
        ax.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.0, ncols=4)
        ax.set_yticks(at, [name for name, _ in rows])
        ax.set_xscale("symlog", linthresh=10.0)
        ax.set_xlim(left=0.0)
        ax.set_xlabel("one effect added to the declared model: gain on steps that were not fitted, nats")
