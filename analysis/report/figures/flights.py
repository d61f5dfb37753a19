"""Figures of flights: bifurcation diagram (Figs. 4-6, 10-12), return maps (7-9), trajectory (1), and their history.

The model lies under the measurement and uses the plate's motion as measured; flagged flights are shown by another mark.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from analysis.flights.compare import Comparison, ball_on, compare
from analysis.flights.table import FlightFlag, Flights
from analysis.loop.result import ClosedLoop
from analysis.plate.motion import StepPlate
from analysis.report.figures import style
from analysis.report.figures.theory import draw_unstable, draw_zones, zones_over
from analysis.report.wording import gamma_scale
from analysis.residuals.held import held_steps
from daq.recording import Recording
from daq.setup.setup import Setup
from model.effects.registry import Effects, ball_effects
from model.orbits.attractor import attractor
from model.orbits.exact_ball import IdealBall
from model.surveys.diagram import diagram

DOUBTFUL = "measured: double hit, or unsure"  # in legends


@dataclass(frozen=True)
class Measured:
    """An open recording and what was made of it."""

    recording: Recording  # open
    flights: Flights
    compared: Comparison | None = None  # with the model; None where no flight was seen
    loop: ClosedLoop | None = None  # None where the loop was not closed


def measured(
    recording: Recording, flights: Flights, compared: Comparison | None = None, loop: ClosedLoop | None = None
) -> Measured:
    """A recording with its flights, compared with the declared model unless ``compared`` is given."""
    if compared is None and len(flights):
        compared = compare(flights, recording.setup, steps_table=recording.steps)
    return Measured(recording, flights, compared, loop)


def draw_bifurcations(shown: Measured, figure: Figure) -> None:
    """Draw measured flight times against gamma over the model's diagram, forbidden zones shaded."""
    recording, flights = shown.recording, shown.flights
    plates = [p for p in flights.plate.steps if p is not None and p.gamma > 0]
    if not plates or not len(flights):
        return
    measure = gamma_scale(recording.setup.forcing, plates[-1].ratio)
    scale = measure.factor
    values = scale * np.array([np.nan if p is None else p.gamma for p in flights.plate.steps])
    figure.set_size_inches(8.0, 5.2)
    ax = figure.subplots()
    low, high = 0.97 * min(p.gamma for p in plates), 1.03 * max(p.gamma for p in plates)
    top = _draw_model(ax, plates[-1], recording.setup, low, high, scale, shown.loop)
    poor = FlightFlag.FALSE | FlightFlag.CUT | FlightFlag.SETTLING | FlightFlag.GAP
    true = ~flights.has(poor) & (flights.step >= 0)
    marked = flights.has(FlightFlag.DOUBLE_HIT | FlightFlag.UNSURE)
    x, y = values[np.maximum(flights.step, 0)], 1e3 * flights.duration_s
    looks: tuple[tuple[Any, str, dict[str, Any]], ...] = (
        (true & ~marked, "o", {"ms": 3.2, "mew": 0, "color": style.MEASURED, "alpha": 0.75, "label": "measured"}),
        (true & marked, "x", {"ms": 4.0, "mew": 0.9, "color": style.DOUBTFUL, "label": DOUBTFUL}),
    )
    for rows, mark, look in looks:
        if mark == "o" or rows.any():
            (line,) = ax.plot(x[rows], y[rows], mark, **look)
            style.name_flights(line, np.flatnonzero(rows))
    if held := held_steps(recording, flights):
        ball = ball_on(plates[-1], recording.setup, recording.setup.declared_values())[0]
        draw_unstable(ax, ball, low, high, scale, 1e3 / plates[-1].omega_radps)
        at = scale * np.array([one.gamma for one in held]), 1e3 * np.array([one.flight_s for one in held])
        ax.plot(*at, "D", ms=6.5, mew=1.2, mfc="none", color=style.IMPROVED, label="held on the branch")
    ax.set_xlabel(measure.label)
    ax.set_ylabel(f"flight time (ms) at {plates[-1].frequency_hz:.2f} Hz")
    top = max(top, float(y[true].max()) if true.any() else 0.0)
    ax.set(xlim=(low * scale, high * scale), ylim=(0.0, 1.06 * top))
    ax.legend(loc="upper left", frameon=True, framealpha=0.9, fontsize=8)


def _draw_model(
    ax: Any, plate: StepPlate, setup: Setup, low: float, high: float, scale: float, loop: ClosedLoop | None
) -> float:
    """The declared model's diagram, that of the improved one, and forbidden zones; returns the longest flight, ms."""
    unit = 1e3 / plate.omega_radps
    declared = setup.declared_values()
    forcing = ball_on(plate, setup, declared)[1]
    above = [zone[zone[:, 1] > 0.0] for zone in zones_over(forcing, np.linspace(low, high, 60))]
    draw_zones(ax, [zone for zone in above if len(zone)], scale, unit, None)
    ax.fill_between([], [], [], color=style.ZONE, label="forbidden to the ideal ball")
    models: list[tuple[Effects, str, str]] = [(declared, "declared model", style.MODEL)]
    added = () if loop is None or loop.verdict != "explained" else loop.selection.names
    if loop is not None and ball_effects({name: {} for name in added}):
        models.append((loop.improved_effects(), "improved model", style.IMPROVED))
    top = 0.0
    for effects, what, color in models:
        ball = ball_on(plate, setup, effects)[0]
        rows = diagram(ball, np.linspace(low, high, 500 if isinstance(ball, IdealBall) else 250))  # others take longer
        y = rows.tau.ravel() * unit
        name = f"{what}: {', '.join(sorted(ball_effects(effects))) or 'ideal'}"
        x = np.repeat(rows.gamma, rows.tau.shape[1]) * scale
        ax.plot(x, y, ".", ms=3.0, mew=0, color=color, zorder=1, rasterized=True)
        ax.plot([], [], ".", ms=8, mew=0, color=color, label=name)
        top = max(top, float(np.nanmax(y)) if np.isfinite(y).any() else 0.0)
    return top


def draw_return_maps(shown: Measured, figure: Figure) -> None:
    """Draw the return map of each of the steps with most modes and flights, measured and predicted."""
    recording, flights, comparison = shown.recording, shown.flights, shown.compared
    if comparison is None:
        return
    ranked = sorted(
        (s for s in comparison.steps if s.measured.flights >= 3),
        key=lambda s: (s.measured.kind == "irregular", s.measured.modes, s.measured.flights),
        reverse=True,
    )
    chosen = sorted(ranked[:6], key=lambda s: s.step)
    if not chosen:
        return
    scale = gamma_scale(recording.setup.forcing, flights.plate.ratio)
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure.set_size_inches(3.1 * columns + 0.4, 3.2 * rows + 0.4)
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.ravel()[len(chosen) :]:
        ax.axis("off")
    for ax, own in zip(axes.ravel(), chosen, strict=False):
        good = (flights.step == own.step) & ~flights.has(FlightFlag.FALSE | FlightFlag.SETTLING | FlightFlag.CUT)
        tau = 1e3 * flights.duration_s[good]
        model = 1e3 * own.predicted_s
        pairs = np.append(model, model[:1]) if own.periodic else model
        ax.plot(pairs[:-1], pairs[1:], "s", ms=9, mew=1.4, mfc="none", color=style.MODEL, label="model")
        (line,) = ax.plot(tau[:-1], tau[1:], "o", ms=3.5, mew=0, color=style.MEASURED, label="measured")
        style.name_flights(line, np.flatnonzero(good)[:-1])
        span = np.concatenate([tau, model])
        pad = 0.08 * (np.ptp(span) if np.ptp(span) > 0 else 1.0) + 0.5
        limits = (span.min() - pad, span.max() + pad)
        ax.plot(limits, limits, "-", lw=0.6, color="0.7", zorder=0)
        ax.set(xlim=limits, ylim=limits, aspect="equal")
        ax.set_title(f"{scale.symbol} = {scale.factor * own.gamma:.3f}: {own.measured.label}", fontsize=9)
    axes[0, 0].legend(fontsize=8, frameon=False)
    figure.supxlabel("flight time (ms)", fontsize=10)
    figure.supylabel("next flight time (ms)", fontsize=10)


def draw_trajectory(shown: Measured, figure: Figure) -> None:
    """Draw plate and ball over a few cycles of the last step with most flights, measured and predicted."""
    recording, flights = shown.recording, shown.flights
    good = flights.good()
    counts = np.bincount(flights.step[good & (flights.step >= 0)], minlength=len(flights.plate.steps))
    plate = flights.plate.steps[int(np.flatnonzero(counts == counts.max())[-1])] if counts.size else None
    if plate is None or counts[plate.step] < 2:
        return
    index = np.flatnonzero(good & (flights.step == plate.step))
    begin = flights.takeoff_s[index[0]] - 0.3 / plate.frequency_hz
    end = begin + 4.0 / plate.frequency_hz  # four cycles of the forcing
    figure.set_size_inches(8.0, 5.0)
    ax, low = figure.subplots(2, 1, sharex=True, height_ratios=(3.2, 1.0))
    t = np.linspace(begin, end, 1200)
    motion = plate.plate()
    at = flights.plate.true_time_s
    height = 1e3 * motion.position_at(at(t))
    ax.plot(1e3 * (t - begin), height, "-", lw=1.6, color=style.PLATE, label="plate, measured")
    for n, i in enumerate(index[flights.takeoff_s[index] < end]):
        # a measured flight: the parabola through its two ends on the plate
        a, b, g = flights.takeoff_s[i], flights.landing_s[i], recording.setup.g_mps2.value
        s = np.linspace(0.0, b - a, 80)
        start, stop = (float(motion.position_at(at(t))) for t in (a, b))
        y = start + ((stop - start) / (b - a) + 0.5 * g * (b - a)) * s - 0.5 * g * s**2
        label = "free fall through measured take-off and landing" if n == 0 else None
        ax.plot(1e3 * (a + s - begin), 1e3 * y, "-", lw=1.4, color=style.MEASURED, label=label)
        ax.plot(1e3 * (np.array([a, b]) - begin), [1e3 * start, 1e3 * stop], "o", ms=4, mew=0, color=style.MEASURED)
    _draw_predicted(ax, flights, plate, recording.setup, begin, end, float(flights.takeoff_s[index[0]]))
    first, last = int(begin * recording.rate_hz), min(int(end * recording.rate_hz), recording.n_samples)
    volts = recording.read_v("continuity", first, last)
    low.plot(1e3 * (np.arange(first, last) / recording.rate_hz - begin), volts, lw=0.8, color=style.MEASURED)
    low.set(xlabel="time (ms)", ylabel="continuity (V)")
    ax.set(ylabel="height (mm)", xlim=(0.0, 1e3 * (end - begin)))
    scale = gamma_scale(recording.setup.forcing, plate.ratio)
    name = f"{scale.symbol} = {scale.factor * plate.gamma:.3f}"
    ax.set_title(f"{name}, c = {plate.ratio}, {plate.frequency_hz:.2f} Hz", fontsize=10, loc="left")
    ax.set_ylim(top=ax.get_ylim()[1] + 0.3 * np.ptp(ax.get_ylim()))
    ax.legend(loc="upper right", fontsize=8, framealpha=0.9)


def _draw_predicted(
    ax: Any, flights: Flights, plate: StepPlate, setup: Setup, begin: float, end: float, start_s: float
) -> None:
    """The model's landings of its own cycle, as dashed flights from the first measured take-off on."""
    g = setup.g_mps2.value
    (ball, _), gamma = ball_on(plate, setup, setup.declared_values()), plate.gamma
    found = attractor(ball, gamma)
    if found.tau.size == 0 or found.kind == "chaotic":
        return
    phase = float(flights.plate.phase(start_s, plate.step))
    k = int(np.argmin(np.abs(np.angle(np.exp(1j * (found.phase - phase))))))
    motion, omega, t = plate.plate(), plate.omega_radps, start_s
    shown = False
    for j in range(k, k + 12 * found.tau.size):
        i = j % found.tau.size
        t += float(np.mod(found.phase[i] - float(flights.plate.phase(t, plate.step)) + 0.1, 2.0 * np.pi) - 0.1) / omega
        if t > end:
            return
        s = np.linspace(0.0, found.tau[i] / omega, 80)
        x, v = (float(f(flights.plate.true_time_s(t))) for f in (motion.position_at, motion.velocity_at))
        y, label = x + v * s - 0.5 * g * s**2, None if shown else "ball, model's cycle"
        ax.plot(1e3 * (t + s - begin), 1e3 * y, "--", lw=1.6, color=style.MODEL, label=label, zorder=5)
        shown = True
        t += float(found.tau[i]) / omega


def draw_history(measured: Measured, figure: Figure) -> None:
    """Draw flight times against time in the run, the predicted cycle of each step as lines, steps named by gamma."""
    recording, flights = measured.recording, measured.flights
    shown = (flights.step >= 0) & ~flights.has(FlightFlag.FALSE | FlightFlag.CUT | FlightFlag.GAP)
    if not shown.any():
        return
    figure.set_size_inches(8.0, 3.8)
    ax = figure.subplots()
    scale = gamma_scale(recording.setup.forcing, flights.plate.ratio)
    label = "model's cycle"
    for own in () if measured.compared is None else measured.compared.steps:
        levels = np.unique(own.predicted_s)
        # more than twelve flight times of a cycle would fill the history with lines
        if own.periodic and 0 < len(levels) <= 12:
            row = recording.steps[own.step]
            ends = (row["first_sample"] + np.array([row["settle_samples"], row["n_samples"]])) / recording.rate_hz
            ax.hlines(1e3 * levels, *ends, color=style.MODEL, lw=2.6, alpha=0.8, zorder=0, label=label)
            label = "_nolegend_"
    settling = shown & flights.has(FlightFlag.SETTLING)
    doubtful = shown & ~settling & flights.has(FlightFlag.DOUBLE_HIT | FlightFlag.UNSURE)
    for rows, mark, size, colour, words in (
        (shown & ~settling & ~doubtful, "o", 2.6, style.MEASURED, "measured"),
        (doubtful, "x", 3.6, style.DOUBTFUL, DOUBTFUL),
        (settling, "+", 3.6, style.FLOOR, "while a step settles"),
    ):
        if rows.any():
            (line,) = ax.plot(
                flights.takeoff_s[rows], 1e3 * flights.duration_s[rows], mark, ms=size, color=colour, label=words,
                mew=0 if mark == "o" else 0.8,
            )  # fmt: skip
            style.name_flights(line, np.flatnonzero(rows))
    ax.set(xlabel="time in the run (s)", ylabel="flight time (ms)")
    ax.set_ylim(0.0, 1.08 * float(1e3 * flights.duration_s[shown].max()))
    plates = [p for p in flights.plate.steps if p is not None and p.gamma > 0]
    top = ax.secondary_xaxis("top")  # steps by their gamma, not more of them than have room
    chosen = plates[:: max(1, -(-len(plates) // 12))]
    first = recording.steps["first_sample"] / recording.rate_hz
    for t in first:
        ax.axvline(float(t), color="0.85", lw=0.6, zorder=-1)
    names = [f"{scale.factor * p.gamma:.3f}" for p in chosen]
    top.set_xticks([float(first[p.step]) for p in chosen], names, fontsize=7)
    top.set_xlabel(f"{scale.symbol} of the step that begins", fontsize=8)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), fontsize=8, frameon=False, ncols=4)  # over no flight
