"""Figures of the flights: bifurcation diagram (Figs. 4-6, 10-12), return maps (Figs. 7-9), trajectory (Fig. 1).

The model lies under the measurement and uses the plate's motion as measured; flagged flights are shown by another mark.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.flights.compare import Comparison, ball_on
from analysis.flights.table import FlightFlag, Flights
from analysis.plate.motion import StepPlate
from analysis.report import style
from analysis.report.gamma import gamma_scale
from analysis.report.zones import draw_zones, zones_over
from daq.recording import Recording
from daq.setup.setup import Setup
from model.effects.routing import Effects, ball_effects
from model.orbits.attractor import attractor
from model.orbits.ideal_ball import IdealBall
from model.surveys.diagram import diagram

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from analysis.loop.result import ClosedLoop

Floats = npt.NDArray[np.float64]

GAMMAS = 500  # points of the model's diagram
ZONE_GAMMAS = 60  # points of the forbidden zones
MAPS = 6  # return maps in one figure
CYCLES = 4.0  # of the forcing, in the trajectory


def draw_bifurcations(recording: Recording, flights: Flights, figure: Figure, loop: ClosedLoop | None = None) -> None:
    """Measured flight times against gamma over the model's diagram, forbidden zones shaded."""
    plates = [p for p in flights.plate.steps if p is not None and p.gamma > 0]
    if not plates:
        return
    shown = gamma_scale(recording.setup.forcing, plates[-1].ratio)
    scale = shown.factor
    values = scale * np.array([np.nan if p is None else p.gamma for p in flights.plate.steps])
    figure.set_size_inches(8.0, 5.2)
    ax = figure.subplots()
    low, high = 0.97 * min(p.gamma for p in plates), 1.03 * max(p.gamma for p in plates)
    top = _draw_model(ax, plates[-1], recording.setup, low, high, scale, loop)
    poor = FlightFlag.FALSE | FlightFlag.CUT | FlightFlag.SETTLING | FlightFlag.GAP
    true = ~flights.has(poor) & (flights.step >= 0)
    marked = flights.has(FlightFlag.DOUBLE_HIT | FlightFlag.UNSURE)
    x, y = values[np.maximum(flights.step, 0)], 1e3 * flights.duration_s
    plain = true & ~marked
    (line,) = ax.plot(x[plain], y[plain], "o", ms=3.2, mew=0, color=style.MEASURED, alpha=0.75, label="measured")
    style.name_flights(line, np.flatnonzero(plain))
    if np.any(true & marked):
        (line,) = ax.plot(
            x[true & marked],
            y[true & marked],
            "x",
            ms=4.0,
            mew=0.9,
            color=style.DOUBTFUL,
            label="measured: double hit, or unsure",
        )
        style.name_flights(line, np.flatnonzero(true & marked))
    ax.set_xlabel(shown.label)
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
    above = [zone[zone[:, 1] > 0.0] for zone in zones_over(forcing, np.linspace(low, high, ZONE_GAMMAS))]
    draw_zones(ax, [zone for zone in above if len(zone)], scale, unit, None)
    ax.fill_between([], [], [], color=style.ZONE, label="forbidden to the ideal ball")
    models: list[tuple[Effects, str, str]] = [(declared, "declared model", style.MODEL)]
    if improved := _improved(declared, loop):
        models.append((improved, "improved model", style.IMPROVED))
    top = 0.0
    for effects, what, color in models:
        ball = ball_on(plate, setup, effects)[0]
        rows = diagram(ball, np.linspace(low, high, GAMMAS if isinstance(ball, IdealBall) else GAMMAS // 2))
        y = rows.tau.ravel() * unit
        name = f"{what}: {', '.join(sorted(ball_effects(effects))) or 'ideal'}"
        x = np.repeat(rows.gamma, rows.tau.shape[1]) * scale
        ax.plot(x, y, ".", ms=3.0, mew=0, color=color, zorder=1, rasterized=True)
        ax.plot([], [], ".", ms=8, mew=0, color=color, label=name)
        top = max(top, float(np.nanmax(y)) if np.isfinite(y).any() else 0.0)
    return top


def _improved(declared: Effects, loop: ClosedLoop | None) -> Effects:
    """The declared effects with those that an explained loop added; none where no effect on the ball was added."""
    if loop is None or loop.verdict != "explained":
        return {}
    added = {one.name: {name: value for name, (value, _, _) in one.parameters.items()} for one in loop.effects}
    if not ball_effects(added):
        return {}
    return {**declared, **{name: {**declared.get(name, {}), **values} for name, values in added.items()}}


def draw_return_maps(recording: Recording, flights: Flights, comparison: Comparison, figure: Figure) -> None:
    """Return map of each of the steps with most modes and flights, measured and predicted."""
    ranked = sorted(
        (s for s in comparison.steps if s.measured.flights >= 3),
        key=lambda s: (s.measured.kind == "irregular", s.measured.modes, s.measured.flights),
        reverse=True,
    )
    chosen = sorted(ranked[:MAPS], key=lambda s: s.step)
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


def draw_trajectory(recording: Recording, flights: Flights, figure: Figure, step: int | None = None) -> None:
    """Plate and ball over a few cycles of one step, measured and predicted from the first take-off."""
    good = flights.good()
    counts = np.bincount(flights.step[good & (flights.step >= 0)], minlength=len(flights.plate.steps))
    step = int(np.flatnonzero(counts == counts.max())[-1]) if step is None and counts.size else step
    plate = flights.plate.steps[step] if step is not None and counts.size else None
    if plate is None or counts[plate.step] < 2:
        return
    index = np.flatnonzero(good & (flights.step == plate.step))
    begin = flights.takeoff_s[index[0]] - 0.3 / plate.frequency_hz
    end = begin + CYCLES / plate.frequency_hz
    figure.set_size_inches(8.0, 5.0)
    ax, low = figure.subplots(2, 1, sharex=True, height_ratios=(3.2, 1.0))
    t = np.linspace(begin, end, 1200)
    motion = plate.plate()
    at = flights.plate.true_time_s
    height = 1e3 * motion.position_at(at(t))
    ax.plot(1e3 * (t - begin), height, "-", lw=1.6, color=style.PLATE, label="plate, measured")
    for n, i in enumerate(index[flights.takeoff_s[index] < end]):
        _draw_flight(ax, flights, int(i), begin, motion, recording.setup.g_mps2.value, first=n == 0)
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


def _draw_flight(ax: Any, flights: Flights, i: int, begin: float, motion: Any, g: float, *, first: bool) -> None:
    """One measured flight: the parabola through its two ends on the plate."""
    a, b = flights.takeoff_s[i], flights.landing_s[i]
    s = np.linspace(0.0, b - a, 80)
    start, stop = (float(motion.position_at(flights.plate.true_time_s(t))) for t in (a, b))
    speed = (stop - start) / (b - a) + 0.5 * g * (b - a)
    y = start + speed * s - 0.5 * g * s**2
    label = "free fall through measured take-off and landing" if first else None
    ax.plot(1e3 * (a + s - begin), 1e3 * y, "-", lw=1.4, color=style.MEASURED, label=label)
    ax.plot(1e3 * (np.array([a, b]) - begin), [1e3 * start, 1e3 * stop], "o", ms=4, mew=0, color=style.MEASURED)


def _draw_predicted(
    ax: Any, flights: Flights, plate: StepPlate, setup: Setup, begin: float, end: float, start_s: float
) -> None:
    """The model's landings of its own cycle, as dashed flights from the first measured take-off on."""
    g = setup.g_mps2.value
    ball, _, gamma = ball_on(plate, setup, setup.declared_values())
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
        ax.plot(
            1e3 * (t + s - begin),
            1e3 * (x + v * s - 0.5 * g * s**2),
            "--",
            lw=1.6,
            color=style.MODEL,
            label=None if shown else "ball, model's cycle",
            zorder=5,
        )
        shown = True
        t += float(found.tau[i]) / omega
