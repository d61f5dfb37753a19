"""Pictures of the closed loop: errors step by step, candidates compared (residuals: `analysis.pictures_residuals`).

The rule kept here: before is always the pale colour and after the dark one, in the same units on the same axis, and the
noise floor is drawn wherever an error is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.close_loop import Loop
from analysis.pictures import figure

Array = NDArray[np.float64]

BEFORE, AFTER, FLOOR, RULED = "#e07a5f", "#12355b", "#8d99ae", "#adb5bd"


def draw_errors(loop: Loop, folder: Path, badge: str) -> None:
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
            rows = ev.judged & (ev.measured.step == s) & np.isfinite(x)
            if rows.any():
                out[s] = 1.4826e6 * np.median(np.abs(x[rows]))
        return out

    floor = np.array(
        [
            1e6 * np.sqrt(np.mean(total[r] ** 2)) if (r := ev.judged & (ev.measured.step == s)).any() else np.nan
            for s in range(m)
        ]
    )
    gamma, label = _gamma(loop)
    held = np.isin(np.arange(m), np.flatnonzero(_held(loop)))
    with figure(folder, "errors", badge, figsize=(7.2, 3.6)) as (_, ax):
        ax.semilogy(gamma, floor, "_", ms=11, mew=2.0, color=FLOOR, label="noise floor")
        for x, colour, name in (
            (per_step(before.landing_s), BEFORE, "before"),
            (per_step(after.landing_s), AFTER, "after"),
        ):
            ax.semilogy(gamma[~held], x[~held], "o", ms=4, color=colour, label=name)
            ax.semilogy(gamma[held], x[held], "D", ms=6, mfc="none", mew=1.5, color=colour, label=f"{name}, held out")
        ax.set_xlabel(label)
        ax.set_ylabel(r"landing error (robust), $\mu$s")
        ax.legend(frameon=False, fontsize=8, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _held(loop: Loop) -> NDArray[np.bool_]:
    return ~loop.best.fitted.fitter.train


def _gamma(loop: Loop) -> tuple[Array, str]:
    """Measured gamma of the steps, in the axis that the paper uses at c = 1."""
    steps = loop.world.evidence.steps
    if np.all(steps.ratio == 1):
        return 2.0 * steps.gamma, r"$\Gamma_{\mathrm{peak}}$   (c = 1)"
    return steps.gamma, r"$\Gamma = A\omega^2/g$"


def draw_candidates(loop: Loop, folder: Path, badge: str, limits: Any) -> None:
    """Held-out gain of every candidate of the first round with its standard error, and what a gain must exceed."""
    best: dict[str, tuple[float, float]] = {}
    for names, compared in loop.attribution.tried:
        name = " + ".join(names)
        if name not in best or compared.gain > best[name][0]:
            best[name] = (compared.gain, compared.error)
    if not best:
        return
    rows = sorted(best.items(), key=lambda item: item[1][0])[-16:]
    chosen = set(loop.best.names)
    with figure(folder, "candidates", badge, figsize=(7.2, 0.9 + 0.26 * len(rows))) as (_, ax):
        at = np.arange(len(rows))
        colours = [AFTER if set(name.split(" + ")) & chosen else RULED for name, _ in rows]
        ax.barh(
            at,
            [max(g, 0.1) for _, (g, _) in rows],
            xerr=[e for _, (_, e) in rows],
            color=colours,
            ecolor="#495057",
            capsize=2,
        )
        needed = f"needed: {limits.gain_nats:g} nats and {limits.gain_sigmas:g} standard errors"
        ax.axvline(limits.gain_nats, color=BEFORE, lw=1.2, ls="--", label=needed)
        ax.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.0)
        ax.set_yticks(at, [name.replace("_", " ") for name, _ in rows])
        ax.set_xscale("symlog", linthresh=10.0)
        ax.set_xlim(left=0.0)
        ax.set_xlabel("gain on steps that were not fitted, nats")
        ax.set_title("one effect added to the declared model", fontsize=9, loc="left")
