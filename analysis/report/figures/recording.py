"""The table of the figures of a recording, which `bench report` and `bench reprocess --figures` draw. Decision 316.

The figure of its plate: transfer function, lag and harmonics step by step, and one period of its acceleration. The
transfer function is shown relative to its median, so that ``g_per_volt`` need not be known.
"""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from analysis.plate.motion import StepPlate
from analysis.report.figures import style
from analysis.report.figures.flights import Measured, draw_bifurcations, draw_history, draw_return_maps, draw_trajectory
from analysis.report.figures.style import Figure
from analysis.report.wording import gamma_scale
from daq.recording import Recording
from kernels.arrays import Floats


def draw_plate(shown: Measured, figure: Canvas) -> None:
    """Draw gain and lag of the plate against the drive at each step, and one period of the largest step."""
    recording = shown.recording
    plates = [p for p in shown.flights.plate.steps if p is not None and p.gamma > 0]
    if not plates:
        return
    scale = gamma_scale(recording.setup.forcing, plates[-1].ratio)
    x = scale.factor * np.array([p.gamma for p in plates])
    figure.set_size_inches(9.0, 6.0)
    axes = figure.subplots(2, 2)
    _transfer(axes[0, 0], axes[1, 0], plates, x)
    axes[1, 0].set_xlabel(scale.label)
    _period(axes[0, 1], recording, plates[-1])
    axes[0, 1].set_title(f"{scale.symbol} = {x[-1]:.3f}", fontsize=9)
    _harmonics(axes[1, 1], plates, x)
    axes[1, 1].set_xlabel(scale.label)


def _transfer(gain_ax: Any, lag_ax: Any, plates: list[StepPlate], x: Floats) -> None:
    """Plate over drive at the forcing's strongest tone: its size relative to the median, and its phase."""
    values, sigmas = [], []
    for p in plates:
        rows = [p.multiples.index(m) for m in p.forcing_multiples]
        k = rows[int(np.argmax(np.abs(p.acceleration.amplitudes[rows])))]
        # not recorded, or its reading cut off
        values.append(complex("nan") if p.drive is None else p.acceleration.amplitudes[k] / p.drive.amplitudes[k])
        sigmas.append(p.acceleration.amplitude_sigma()[k] / np.abs(p.acceleration.amplitudes[k]))
    transfer, sigma = np.array(values, dtype=np.complex128), np.array(sigmas)
    size = np.abs(transfer)
    middle = float(np.nanmedian(size)) if np.isfinite(size).any() else 1.0
    look: dict[str, Any] = {"fmt": "o", "ms": 3.5, "lw": 0.8, "color": style.MEASURED}
    gain_ax.errorbar(x, 100.0 * (size / middle - 1.0), 100.0 * sigma, label="measured", **look)
    lag_ax.errorbar(x, np.degrees(np.angle(transfer)), np.degrees(sigma), **look)
    for ax in (gain_ax, lag_ax):
        ax.axhline(0.0, lw=1.2, color=style.MODEL, label="a linear shaker")
    gain_ax.set_ylabel("plate / drive, deviation (%)")
    gain_ax.set_title(f"median gain {middle:.4g} (m/s²)/V", fontsize=9)
    gain_ax.legend(fontsize=8, frameon=False)
    lag_ax.set_ylabel("plate ahead of drive (deg)")


def _period(ax: Any, recording: Recording, plate: StepPlate) -> None:
    """One period of the step, all its samples folded, with the fitted tones."""
    # at most 400 000 samples are folded into one period
    first, last = plate.first_sample, min(plate.last_sample, plate.first_sample + 400_000)
    channel = recording.setup.channels.accelerometer
    zero_v = channel.offset_v.value if channel.offset_v is not None else 0.0
    a = (recording.read_v("accelerometer", first, last) - zero_v) / channel.volts_per_mps2 - plate.acceleration.offset
    t = np.arange(first, last) / recording.rate_hz
    place = np.mod(plate.frequency_hz * t + plate.phase0_rad / (2.0 * np.pi), 1.0)
    keep = slice(None, None, max(1, a.size // 12000))
    ax.plot(place[keep], a[keep], ".", ms=1.0, mew=0, color=style.MEASURED, rasterized=True, label="accelerometer")
    grid = np.linspace(0.0, 1.0, 400)
    start = (grid - plate.phase0_rad / (2.0 * np.pi)) / plate.frequency_hz
    ax.plot(grid, plate.plate().acceleration_at(start), "-", lw=1.4, color=style.MODEL, label="fitted tones")
    ax.set(xlabel="forcing period", ylabel="acceleration (m/s²)", xlim=(0.0, 1.0))
    ax.legend(fontsize=8, frameon=False, markerscale=6)


def _harmonics(ax: Any, plates: list[StepPlate], x: Floats) -> None:
    """Harmonics and slow lines, relative to the forcing."""
    tones = [m for m in plates[-1].multiples if m not in plates[-1].forcing_multiples]
    for m, (colour, mark, dashes) in zip(tones, cycle(style.HARMONICS)):
        own = np.array([abs(p.tone(m)[0]) if m in p.multiples else np.nan for p in plates])
        whole = np.array([np.abs(p.acceleration.amplitudes).max() for p in plates])
        ax.plot(
            x, 100.0 * own / whole, mark, ls=dashes, ms=4.5, mfc="white", mew=1.1, lw=0.9, color=colour, label=f"{m} f"
        )
    for p, at in zip(plates, x, strict=True):
        for line in p.lines:
            size = 100.0 * line.amplitude_mps2 / float(np.abs(p.acceleration.amplitudes).max())
            ax.plot(at, size, "v", color="k", ms=4)
            ax.annotate(f"{line.frequency_hz:.1f} Hz", (float(at), size), fontsize=6)
    ax.set(ylabel="harmonics, of the forcing (%)", yscale="log")
    style.plain_decades(ax.yaxis)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * (high / low) ** 0.25)  # room for the legend above the lines
    ax.legend(fontsize=8, frameon=False, ncol=4, loc="upper right", handlelength=3.2)


FIGURES = (
    Figure(
        "bifurcation", draw_bifurcations, "flights",
        "Bifurcation diagram: flight times against gamma, measured (dark dots; crosses: double hit or unsure) over the "
        "prediction for the plate's motion as measured (light). Shaded: flight times forbidden to the ideal ball. "
        "Diamonds: steps in which the ball was held on an unstable cycle (dashed: predicted).",
    ),
    Figure(
        "return_maps", draw_return_maps, "flights",
        "Return maps of the steps with most modes: each flight time against the one before (dots), and the predicted "
        "cycle (open squares).",
    ),
    Figure(
        "history", draw_history, "flights",
        "Flight times in order of time. Bars: the predicted cycle of each step. Plus signs: the step still settles.",
    ),
    Figure(
        "trajectory", draw_trajectory, "flights",
        "Plate and ball over a few periods, with the contact voltage below.",
    ),
    Figure(
        "plate", draw_plate, "plate",
        "The plate's gain and lag against the drive (of steps that recorded the whole drive), one period of its "
        "acceleration, and its harmonics.",
    ),
)  # fmt: skip
