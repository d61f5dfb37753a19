"""Pictures of a drop test: did the tracker follow the ball, and what is left after the fit.

The rule kept here: a picture shows the data and the fit together, with units on its axes, so that a person can
disagree with the numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from analysis.drop.attribution import Verdict
from analysis.drop.camera import CameraFit
from analysis.drop.rows import Drop
from analysis.drop.tracking import Tracked


def draw_track(tracked: Tracked, title: str, target: Path) -> Path:
    """The track over a composite of frames: every measured centre should sit in the middle of a ball."""
    rows, columns = tracked.composite.shape[:2]
    figure = Figure(figsize=(11, max(11 * rows / columns, 4) + 0.6), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(tracked.composite[:, :, ::-1])
    marks: Any = axes.scatter(tracked.track.x, np.abs(tracked.track.height), c=tracked.track.clock, s=10, cmap="plasma")
    axes.plot(tracked.track.x, np.abs(tracked.track.height), lw=0.4, color="white")
    figure.colorbar(marks, label="frame", shrink=0.8)
    heading = f"{title}: {len(tracked.track.clock)} frames followed, {len(tracked.lost)} lost"
    axes.set(title=heading, xlabel="px", ylabel="px")
    figure.savefig(target, dpi=90)
    return target


def draw_camera(fit: CameraFit, shape_name: str, title: str, target: Path, frame_s: float | None) -> Path:
    """Paths with their fitted flights, and the residuals of the chosen shape and of the parabola."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    top, bottom = figure.subplots(2, 1, height_ratios=[2, 1], sharex=True)
    step, unit = (frame_s, "s") if frame_s else (1.0, "frames")
    for name, axes_colour in dict.fromkeys([("parabola", "tab:orange"), (shape_name, "tab:blue")]):
        shape = fit.shapes[name]
        for i, flight in enumerate(fit.flights):
            curve = shape.apex_height[i] - shape.law.drop_m(flight.frame - shape.apex_frame[i])
            label = f"{name}, rms {shape.sigma:.2f}" if i == 0 else None
            bottom.plot(flight.frame * step, flight.height - curve, ".", ms=4, color=axes_colour, label=label)
            if name == shape_name:
                top.plot(flight.frame * step, flight.height, "k.", ms=3)
                grid = np.linspace(flight.frame[0], flight.frame[-1], 60)
                drop = shape.law.drop_m(grid - shape.apex_frame[i])
                top.plot(grid * step, shape.apex_height[i] - drop, lw=1, color=axes_colour)
    bottom.axhline(0.0, color="grey", lw=0.5)
    bottom.legend(fontsize=8)
    top.set(title=title, ylabel="height (file's unit)")
    bottom.set(xlabel=f"time ({unit})", ylabel="measured - fitted")
    figure.savefig(target, dpi=90)
    return target


def draw_times(drops: Sequence[Drop], verdict: Verdict, target: Path) -> Path:
    """Ratio of successive flights against the flight before, and residuals before and after the added effect."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for drop in drops:
        flights, n = drop.bounces.intervals_s, drop.bounces.usable
        top.plot(1e3 * flights[n - 1], flights[n] / flights[n - 1], ".", ms=5)
    for name, colour in (("constant_restitution", "tab:orange"), (verdict.chosen, "tab:blue")):
        rung = verdict.rung(name)
        label = f"{name}, rms {1e3 * rung.rms_s:.2f} ms"
        for d, drop in enumerate(drops):
            left = rung.fit.residuals_s[d]
            n = drop.bounces.usable
            before = drop.bounces.intervals_s[n - 1]
            from_height = int(drop.height_m is not None and drop.bounces.missed[0] == 0)
            left = 1e3 * left[from_height : from_height + len(before)]
            bottom.plot(1e3 * before, left, ".", ms=5, color=colour, label=label if d == 0 else None)
        if name == verdict.chosen == "constant_restitution":
            break
    bottom.axhline(0.0, color="grey", lw=0.5)
    bottom.legend(fontsize=8)
    title = drops[0].name if len(drops) == 1 else f"{len(drops)} drops ({drops[0].name} ...)"
    top.set(title=title, ylabel="flight after / flight before")
    bottom.set(xlabel="flight before (ms)", ylabel="measured - predicted (ms)")
    figure.savefig(target, dpi=90)
    return target
