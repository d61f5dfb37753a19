"""Figures of a drop test: the track over the film, the waveform with its impacts, the fit and its residuals.

The picture on paper and the page in a browser draw the same `FitPlot`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from analysis.drop.falls.fit import heights_m
from analysis.drop.falls.outcome import Judged as JudgedFalls
from analysis.drop.film.camera_fit import CameraFit
from analysis.drop.film.tracking import Tracked
from analysis.drop.laws import Verdict
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.outcome import Judged
from daq.files.wav import open_wav
from kernels.arrays import Floats

Curve = tuple[Floats, Floats]

_FLIGHT_GRID = 60


@dataclass(frozen=True)
class ModelCurve:
    """One model: its name with its rms, its curve in pieces, and measured less predicted at each set of data."""

    label: str
    pieces: list[Curve]
    left: list[Curve]


@dataclass(frozen=True)
class FitPlot:
    """Data and models."""

    x_label: str  # with unit
    y_label: str  # with unit
    left_label: str  # with unit
    data: list[Curve]  # (x, y), one for each drop or flight
    models: list[ModelCurve]  # the plainest model first, then the best where it is another
    clips: list[int]  # which file each of ``data`` is from
    balls: list[str]  # which ball each of ``data`` is of; empty where all are of one

    def as_json(self) -> dict[str, Any]:
        """The same in plain lists; None for what is not finite."""

        def plain(values: Floats) -> list[float | None]:
            return [round(v, 9) if np.isfinite(v) else None for v in values.tolist()]

        def lists(curves: Sequence[Curve]) -> list[dict[str, list[float | None]]]:
            return [{"x": plain(x), "y": plain(y)} for x, y in curves]

        models = [{"label": m.label, "pieces": lists(m.pieces), "left": lists(m.left)} for m in self.models]
        return vars(self) | {"data": lists(self.data), "models": models}


def in_plain_words(name: str) -> str:
    """A model's name as a legend says it: ``quadratic_drag+axis_distortion`` is "quadratic drag, axis distortion"."""
    return name.replace("+", ", ").replace("_", " ")


def times_plot(drops: Sequence[Drop], verdict: Verdict[Judged], g_mps2: float) -> FitPlot:
    """Ratio of successive flights over the flight before: flat for a constant restitution."""
    data, befores = [], []
    for drop in drops:
        flights, n = drop.bounces.intervals_s, drop.bounces.usable
        befores.append(flights[n - 1])
        data.append((1e3 * flights[n - 1], flights[n] / flights[n - 1]))
    all_before = np.concatenate(befores)
    grid = np.linspace(float(all_before.min()), float(all_before.max()), 200)
    models = []
    for name in dict.fromkeys(["constant_restitution", verdict.best]):
        candidate = verdict.candidate(name)
        after = candidate.model.next_flight_s(candidate.fit.theta, grid, g_mps2)
        left = []
        for drop, before, residuals in zip(drops, befores, candidate.fit.residuals_s, strict=True):
            first = int(drop.height_m is not None and drop.bounces.missed[0] == 0)  # that row starts from the height
            left.append((1e3 * before, 1e3 * residuals[first : first + len(before)]))
        label = f"{in_plain_words(name)}, rms {1e3 * candidate.rms:.2f} ms"
        models.append(ModelCurve(label, [(1e3 * grid, after / grid)], left))
    labels = ("flight before (ms)", "flight after / flight before", "measured - predicted (ms)")
    return FitPlot(*labels, data, models, list(range(len(drops))), [])


def camera_plot(fit: CameraFit, shape_name: str, step_s: Sequence[float | None]) -> FitPlot:
    """Paths with their fitted flights; ``step_s``: seconds a frame in each file's own time, None where unknown."""
    steps = [step_s[flight.clip] or 1.0 for flight in fit.flights]
    data = [(flight.frame * step, flight.height) for flight, step in zip(fit.flights, steps, strict=True)]
    models = []
    for name in dict.fromkeys(["parabola", shape_name]):
        shape = fit.shapes[name]
        pieces, left = [], []
        for i, (flight, step) in enumerate(zip(fit.flights, steps, strict=True)):
            grid = np.linspace(flight.frame[0], flight.frame[-1], _FLIGHT_GRID)
            pieces.append((grid * step, shape.seen_at(i, grid)))
            left.append((flight.frame * step, flight.height - shape.seen_at(i, flight.frame)))
        models.append(ModelCurve(f"{in_plain_words(name)}, rms {shape.sigma:.2f}", pieces, left))
    unit = "time in the file (s)" if step_s[0] else "frame"
    return FitPlot(unit, "height (file's unit)", "measured - fitted", data, models, [f.clip for f in fit.flights], [])


def falls_plot(judged: JudgedFalls, clips: list[int]) -> FitPlot:
    """Heights of falls with free fall and the law chosen; ``clips``: the file of each fall."""
    data = [(fall.time_s, fall.height_m) for fall in judged.falls]
    models = []
    for name in dict.fromkeys(["free_fall", judged.best.model.name]):
        fit = judged.verdict.candidate(name).fit
        grids = [np.linspace(fall.time_s[0], fall.time_s[-1], _FLIGHT_GRID) for fall in judged.falls]
        pieces = [
            (grid, heights_m(fit.values, judged.setting, [fall], [grid]))
            for fall, grid in zip(judged.falls, grids, strict=True)
        ]
        left = [(fall.time_s, own) for fall, own in zip(judged.falls, fit.left, strict=True)]
        models.append(ModelCurve(f"{in_plain_words(name)}: {100 * fit.rms_m:.0f} cm rms", pieces, left))
    balls = [fall.ball for fall in judged.falls]
    return FitPlot("time in the file (s)", "height (m)", "measured - fitted (m)", data, models, clips, balls)


def draw_track(tracked: Tracked, title: str, target: Path) -> Path:
    """The track over a composite of frames: every measured centre should sit in the middle of a ball."""
    from matplotlib.figure import Figure  # slow to import: a page draws the numbers by itself

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
    from matplotlib.figure import Figure

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
    from matplotlib.figure import Figure

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
