"""Figures of a drop test: the track over the film, the waveform with its impacts, the fit and its residuals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from analysis.drop.curves import FitPlot
from analysis.drop.film.tracking import Tracked
from analysis.drop.times.model_fit import Drop
from daq.files.wav import open_wav


def draw_track(tracked: Tracked, title: str, target: Path) -> Path:
    """The track over a composite of frames: every measured centre should sit in the middle of a ball."""
    rows, columns = tracked.composite.shape[:2]
    figure = Figure(figsize=(11, max(11 * rows / columns, 4) + 0.6), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(tracked.composite[:, :, ::-1])
    marks: Any = axes.scatter(tracked.x_px, tracked.y_px, c=tracked.track.clock, s=10, cmap="plasma")
    axes.plot(tracked.x_px, tracked.y_px, lw=0.4, color="white")
    figure.colorbar(marks, label="frame", shrink=0.8)
    heading = f"{title}: {len(tracked.track.clock)} frames followed, {len(tracked.lost)} lost"
    axes.set(title=heading, xlabel="px", ylabel="px")
    figure.savefig(target, dpi=90)
    return target


def draw_fit(plot: FitPlot, title: str, target: Path) -> Path:
    """The data with the models' curves through them, and what each model leaves; a colour a ball where they differ."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    top, bottom = figure.subplots(2, 1, height_ratios=[2, 1], sharex=True)
    balls = list(dict.fromkeys(plot.balls))
    by_ball = {ball: f"C{k % 10}" for k, ball in enumerate(balls)} if len(balls) > 1 else {}
    own = [by_ball.get(ball, "black") for ball in plot.balls or [""] * len(plot.data)]
    labelled = [ball not in plot.balls[:k] for k, ball in enumerate(plot.balls)] if by_ball else [False] * len(own)
    for k, (x, y) in enumerate(plot.data):
        top.plot(x, y, ".", ms=3, color=own[k], label=plot.balls[k] if labelled[k] else None)
    # Where colours distinguish the balls, the plainest model is dotted and marked by a cross, the best solid and a dot.
    styles = ((":", "x", "tab:orange"), ("-", ".", "tab:blue"))
    for model, (line, mark, usual) in zip(plot.models, styles, strict=False):
        line = line if by_ball else "-"
        for k, (x, y) in enumerate(model.pieces):
            top.plot(x, y, line, lw=1, color=own[k] if by_ball else usual)
        for k, (x, y) in enumerate(model.left):
            bottom.plot(x, y, mark if by_ball else ".", ms=4, color=own[k] if by_ball else usual)
        shown = "grey" if by_ball else usual
        top.plot([], [], line, marker=mark if by_ball else ".", ms=4, lw=1, color=shown, label=model.label)
    bottom.axhline(0.0, color="grey", lw=0.5)
    top.legend(fontsize=8)
    top.set(title=title, ylabel=plot.y_label)
    bottom.set(xlabel=plot.x_label, ylabel=plot.left_label)
    figure.savefig(target, dpi=90)
    return target


def draw_sound(path: Path, drops: Sequence[Drop], target: Path) -> Path:
    """The waveform with the detected impacts marked; a row for each drop, six at most."""
    wav = open_wav(path)
    shown = drops[:6]  # drops of a sound, at most
    figure = Figure(figsize=(12, 1.0 + 2.2 * len(shown)), layout="constrained")
    rows: Any = np.atleast_1d(np.asarray(figure.subplots(len(shown), 1)))
    for axes, drop in zip(rows, shown, strict=True):
        bounces = drop.bounces
        start = max(float(bounces.impacts_s[0]) - 0.3, 0.0)
        stop = min(float(bounces.impacts_s[-1]) + 0.3, wav.n_samples / wav.rate_hz)
        at, low, high = wav.envelope(start, stop, 3000)
        axes.fill_between(at, low, high, color="0.6", lw=0)
        top = 1.1 * max(float(high.max(initial=1e-9)), -float(low.min(initial=-1e-9)))
        axes.vlines(bounces.impacts_s, -top, top, color="tab:blue", lw=0.8, label="impact")
        broken = bounces.impacts_s[bounces.broken]
        axes.vlines(broken, -top, top, color="tab:orange", lw=1.5, label="irregular bounce")
        axes.plot(bounces.false_s, np.zeros(len(bounces.false_s)), "kx", ms=6, label="no impact of this ball")
        gaps = np.full(len(bounces.gaps_s), 0.8 * top)
        axes.plot(bounces.gaps_s, gaps, "v", color="tab:red", ms=6, label="impact missed here")
        axes.set(xlim=(start, stop), ylim=(-top, top), ylabel=drop.name[-24:], yticks=[])
    rows[0].legend(fontsize=7, loc="upper right", ncols=4)
    rows[-1].set_xlabel("time in the file (s)")
    figure.savefig(target, dpi=90)
    return target
