"""The first bifurcation beyond take-off as a function of friction and restitution: table, picture, up and down ramps.

Run: ``python -m benchmarks.model.first_bifurcation docs/pictures``. One sine; from rest, gamma stepped up and down.
"""

from __future__ import annotations

import math
import sys
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np

from model.bifurcations.sweep import key
from model.orbits.attractor import AT_REST, Attractor, attractor, sweep
from model.orbits.exact_ball import FrictionBall
from model.tones import Forcing

FORCING = Forcing.superposition(1)
FRICTIONS = np.linspace(0.0, 0.4, 9)
RESTITUTIONS = np.array([0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
STEPS = 100
MOST_FLIGHTS = 400


def first(ball: FrictionBall, direction: int) -> float:
    """gamma_peak of the first change of the 1-cycle, stepping up, or of the last change, stepping down."""
    grid = np.linspace(0.5 * (1.0 + ball.mu_up) + 0.01, 0.5 * (4.7 + 1.2 * ball.mu_up), STEPS)
    if direction > 0:
        last = attractor(ball, float(grid[0]), max_flights=MOST_FLIGHTS)
        for low, high in pairwise(grid):
            new = attractor(ball, float(high), last.last, MOST_FLIGHTS)
            if key(new) != key(last):
                return changed(ball, float(low), float(high), last)
            last = new
        return math.nan
    state, found = AT_REST, []
    for gamma in grid[::-1]:
        found.append(attractor(ball, float(gamma), state, MOST_FLIGHTS))
        state = found[-1].last
    changes = [i for i in range(1, STEPS) if key(found[i]) != key(found[i - 1])]
    at = changes[-1]
    return changed(ball, float(grid[::-1][at - 1]), float(grid[::-1][at]), found[at - 1])


def changed(ball: FrictionBall, a: float, b: float, at: Attractor) -> float:
    """The first change from gamma ``a`` towards ``b``, bisected with the state carried: its gamma_peak."""
    while abs(b - a) > 1e-10:
        middle = 0.5 * (a + b)
        new = attractor(ball, middle, at.last, MOST_FLIGHTS)
        if key(new) == key(at):
            a, at = middle, new
        else:
            b = middle
    return a + b


def table(folder: Path) -> None:
    """Print the table as Markdown and draw the map."""
    up = np.empty((FRICTIONS.size, RESTITUTIONS.size))
    down = np.empty_like(up)
    for i, mu in enumerate(FRICTIONS):
        for j, e in enumerate(RESTITUTIONS):
            ball = FrictionBall(FORCING, float(mu), float(mu), float(e))
            up[i, j], down[i, j] = first(ball, +1), first(ball, -1)
    print("| mu \\ e | " + " | ".join(f"{e:g}" for e in RESTITUTIONS) + " |")
    print("|---" * (RESTITUTIONS.size + 1) + "|")
    for i, mu in enumerate(FRICTIONS):
        cells = [f"{up[i, j]:.4f} / {down[i, j]:.4f}" for j in range(RESTITUTIONS.size)]
        print(f"| {mu:.2f} | " + " | ".join(cells) + " |")
    draw(folder / "first_bifurcation.png", up, down)


def draw(path: Path, up: np.ndarray, down: np.ndarray) -> None:
    """Two maps side by side: stepping up, stepping down."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9.0, 3.8), sharey=True, constrained_layout=True)
    edges = np.arange(RESTITUTIONS.size + 1) - 0.5
    rows = np.append(FRICTIONS, FRICTIONS[-1] + 0.05) - 0.025
    low, high = float(np.nanmin([up, down])), float(np.nanmax([up, down]))
    titles = ("first change, gamma stepped up", "last change, gamma stepped down")
    for ax, values, title in zip(axes, (up, down), titles, strict=True):
        image = ax.pcolormesh(edges, rows, values, cmap="cividis", vmin=low, vmax=high)
        for i, mu in enumerate(FRICTIONS):
            for j in range(RESTITUTIONS.size):
                light = values[i, j] < 0.5 * (low + high)
                ax.text(j, mu, f"{values[i, j]:.2f}", ha="center", va="center", fontsize=6, color="w" if light else "k")
        ax.set_xticks(range(RESTITUTIONS.size), [f"{e:g}" for e in RESTITUTIONS], fontsize=7)
        ax.set_xlabel("restitution e")
        ax.set_title(title, fontsize=10)
    axes[0].set_ylabel("friction mu (of the weight)")
    figure.colorbar(image, ax=axes, label=r"$\Gamma_{\mathrm{peak}}$")
    figure.savefig(path, dpi=180)


def ramps(path: Path) -> None:
    """Flight times of a ramp up and a ramp down at restitution 0.3, where attractors coexist."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    ball = FrictionBall(FORCING, e0=0.3)
    gammas = np.linspace(0.45, 1.3, 800)
    figure, axes = pyplot.subplots(2, 1, figsize=(7.0, 5.4), sharex=True, sharey=True, constrained_layout=True)
    for ax, order, name in zip(axes, (gammas, gammas[::-1]), ("up", "down"), strict=True):
        points(ax, order, sweep(ball, order.tolist()))
        ax.set_title(f"gamma stepped {name}, e = 0.3", fontsize=10, loc="left")
        ax.set_ylabel("flight time (periods)")
        lock = math.pi * 0.7 / 1.3
        ax.axvline(lock, color="#9b2226", lw=0.7, ls="--")
        ax.axvline(math.sqrt(lock**2 + (2 * 1.09 / 1.69) ** 2), color="#9b2226", lw=0.7, ls="--")
    axes[1].set_xlabel(r"$\Gamma_{\mathrm{peak}}$   (dashed: the locked 1-cycle exists from, and is stable to)")
    figure.savefig(path, dpi=180)


def points(ax: object, gammas: np.ndarray, found: list[Attractor]) -> None:
    """Every flight of every attractor."""
    x = np.concatenate([np.full(a.tau.size, 2.0 * g) for g, a in zip(gammas, found, strict=True)])
    y = np.concatenate([a.tau for a in found]) / (2.0 * math.pi)
    ax.plot(x, y, ".", ms=1.5, mew=0, color="#16324f")  # type: ignore[attr-defined]


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    ramps(target / "ramps_up_down.png")
    table(target)
