"""Figures of a drop test: the track over the film, the waveform with its impacts, the fit and its residuals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from analysis.drop.film.camera_fit import CameraFit
from analysis.drop.film.tracking import Tracked
from analysis.drop.times.model_selection import Verdict
from analysis.drop.times.one_ahead import Drop
from analysis.drop.times.wav import open_wav

_ROWS, _COLUMNS = 6, 3000


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


def draw_camera(fit: CameraFit, shape_name: str, title: str, target: Path, frame_s: float | None) -> Path:
    """Paths with their fitted flights, and the residuals of the chosen shape and of the parabola."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    top, bottom = figure.subplots(2, 1, height_ratios=[2, 1], sharex=True)
    step, unit = (frame_s, "s") if frame_s else (1.0, "frames")
    for name, axes_colour in dict.fromkeys([("parabola", "tab:orange"), (shape_name, "tab:blue")]):
        shape = fit.shapes[name]
        for i, flight in enumerate(fit.flights):
            curve = shape.seen(shape.apex_height[i] - shape.law.drop_m(flight.frame - shape.apex_frame[i]))
            label = f"{name}, rms {shape.sigma:.2f}" if i == 0 else None
            bottom.plot(flight.frame * step, flight.height - curve, ".", ms=4, color=axes_colour, label=label)
            if name == shape_name:
                top.plot(flight.frame * step, flight.height, "k.", ms=3)
                grid = np.linspace(flight.frame[0], flight.frame[-1], 60)
                drop = shape.law.drop_m(grid - shape.apex_frame[i])
                top.plot(grid * step, shape.seen(shape.apex_height[i] - drop), lw=1, color=axes_colour)
    bottom.axhline(0.0, color="grey", lw=0.5)
    bottom.legend(fontsize=8)
    top.set(title=title, ylabel="height (file's unit)")
    bottom.set(xlabel=f"time ({unit})", ylabel="measured - fitted")
    figure.savefig(target, dpi=90)
    return target


def draw_times(drops: Sequence[Drop], verdict: Verdict, g_mps2: float, target: Path) -> Path:
    """Ratio of successive flights with the model's curve through them, and residuals before and after the effect."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    longest, shortest = 0.0, np.inf
    for drop in drops:
        flights, n = drop.bounces.intervals_s, drop.bounces.usable
        top.plot(1e3 * flights[n - 1], flights[n] / flights[n - 1], ".", ms=5)
        longest, shortest = max(longest, float(flights[n - 1].max())), min(shortest, float(flights[n - 1].min()))
    grid = np.linspace(shortest, longest, 200)
    for name, colour in dict.fromkeys([("constant_restitution", "tab:orange"), (verdict.best, "tab:blue")]):
        candidate = verdict.candidate(name)
        after = candidate.model.next_flight_s(candidate.fit.theta, grid, g_mps2)
        top.plot(1e3 * grid, after / grid, lw=1, color=colour)
        label = f"{name}, rms {1e3 * candidate.rms_s:.2f} ms"
        for d, drop in enumerate(drops):
            left = candidate.fit.residuals_s[d]
            n = drop.bounces.usable
            before = drop.bounces.intervals_s[n - 1]
            from_height = int(drop.height_m is not None and drop.bounces.missed[0] == 0)
            left = 1e3 * left[from_height : from_height + len(before)]
            bottom.plot(1e3 * before, left, ".", ms=5, color=colour, label=label if d == 0 else None)
    bottom.axhline(0.0, color="grey", lw=0.5)
    bottom.legend(fontsize=8)
    title = drops[0].name if len(drops) == 1 else f"{len(drops)} drops ({drops[0].name} ...)"
    top.set(title=title, ylabel="flight after / flight before")
    bottom.set(xlabel="flight before (ms)", ylabel="measured - predicted (ms)")
    figure.savefig(target, dpi=90)
    return target


def draw_sound(path: Path, drops: Sequence[Drop], target: Path) -> Path:
    """The waveform with the detected impacts marked; a row for each drop, six at most."""
    wav = open_wav(path)
    shown = drops[:_ROWS]
    figure = Figure(figsize=(12, 1.0 + 2.2 * len(shown)), layout="constrained")
    rows: Any = np.atleast_1d(np.asarray(figure.subplots(len(shown), 1)))
    for axes, drop in zip(rows, shown, strict=True):
        bounces = drop.bounces
        start = max(float(bounces.impacts_s[0]) - 0.3, 0.0)
        stop = min(float(bounces.impacts_s[-1]) + 0.3, wav.n_samples / wav.rate_hz)
        first = int(start * wav.rate_hz)
        wave = wav.read(first, int(stop * wav.rate_hz))[:, 0]
        step = max(len(wave) // _COLUMNS, 1)
        parts = wave[: len(wave) // step * step].reshape(-1, step)
        at = (first + step * np.arange(len(parts))) / wav.rate_hz
        axes.fill_between(at, parts.min(axis=1), parts.max(axis=1), color="0.6", lw=0)
        top = 1.1 * float(np.abs(wave).max(initial=1e-9))
        axes.vlines(bounces.impacts_s, -top, top, color="tab:blue", lw=0.8, label="impact")
        broken = bounces.impacts_s[bounces.broken]
        axes.vlines(broken, -top, top, color="tab:orange", lw=1.5, label="irregular bounce")
        axes.plot(bounces.false_s, np.zeros(len(bounces.false_s)), "kx", ms=6, label="no impact of this ball")
        gaps = np.flatnonzero(bounces.missed)
        middles = 0.5 * (bounces.impacts_s[gaps] + bounces.impacts_s[gaps + 1])
        axes.plot(middles, np.full(len(gaps), 0.8 * top), "v", color="tab:red", ms=6, label="impact missed here")
        axes.set(xlim=(start, stop), ylim=(-top, top), ylabel=drop.name[-24:], yticks=[])
    rows[0].legend(fontsize=7, loc="upper right", ncols=4)
    rows[-1].set_xlabel("time in the file (s)")
    figure.savefig(target, dpi=90)
    return target
