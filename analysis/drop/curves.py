"""What a figure of a drop test shows, as numbers: the data, each model's curve through them, and what is left.

The picture on paper and the page in a browser draw the same `FitPlot`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film.camera_fit import CameraFit
from analysis.drop.times.model_selection import Verdict
from analysis.drop.times.one_ahead import Drop

Array = NDArray[np.float64]
Points = tuple[Array, Array]

_GRID = 200
_FLIGHT_GRID = 60


@dataclass(frozen=True)
class ModelCurve:
    """One model: its name with its rms, its curve in pieces, and measured less predicted at each set of data."""

    label: str
    pieces: list[Points]
    left: list[Points]


@dataclass(frozen=True)
class FitPlot:
    """Data and models.

    Attributes
    ----------
    x_label, y_label, left_label : str
        Axes, with units.
    data : list of (x, y)
        One for each drop, or flight.
    models : list of ModelCurve
        The plainest model first, then the best where it is another.
    clips : list of int
        Which file each of ``data`` is from.
    """

    x_label: str
    y_label: str
    left_label: str
    data: list[Points]
    models: list[ModelCurve]
    clips: list[int]

    def as_json(self) -> dict[str, Any]:
        """The same in plain lists."""
        return {
            "x_label": self.x_label, "y_label": self.y_label, "left_label": self.left_label,
            "data": _lists(self.data), "clips": self.clips,
            "models": [
                {"label": m.label, "pieces": _lists(m.pieces), "left": _lists(m.left)} for m in self.models
            ],
        }  # fmt: skip


def _lists(points: Sequence[Points]) -> list[dict[str, list[float | None]]]:
    return [{"x": _plain(x), "y": _plain(y)} for x, y in points]


def _plain(values: Array) -> list[float | None]:
    return [round(v, 9) if np.isfinite(v) else None for v in values.tolist()]


def times_plot(drops: Sequence[Drop], verdict: Verdict, g_mps2: float) -> FitPlot:
    """Ratio of successive flights over the flight before: flat for a constant restitution."""
    data, befores = [], []
    for drop in drops:
        flights, n = drop.bounces.intervals_s, drop.bounces.usable
        befores.append(flights[n - 1])
        data.append((1e3 * flights[n - 1], flights[n] / flights[n - 1]))
    all_before = np.concatenate(befores)
    grid = np.linspace(float(all_before.min()), float(all_before.max()), _GRID)
    models = []
    for name in dict.fromkeys(["constant_restitution", verdict.best]):
        candidate = verdict.candidate(name)
        after = candidate.model.next_flight_s(candidate.fit.theta, grid, g_mps2)
        left = []
        for d, drop in enumerate(drops):
            from_height = int(drop.height_m is not None and drop.bounces.missed[0] == 0)
            own = candidate.fit.residuals_s[d][from_height : from_height + len(befores[d])]
            left.append((1e3 * befores[d], 1e3 * own))
        label = f"{name}, rms {1e3 * candidate.rms_s:.2f} ms"
        models.append(ModelCurve(label, [(1e3 * grid, after / grid)], left))
    labels = ("flight before (ms)", "flight after / flight before", "measured - predicted (ms)")
    return FitPlot(*labels, data, models, list(range(len(drops))))


def camera_plot(fit: CameraFit, shape_name: str, step_s: Sequence[float | None]) -> FitPlot:
    """Paths with their fitted flights; ``step_s``: seconds a frame in each file's own time, None where unknown."""
    steps = [step or 1.0 for step in step_s]
    data = [(flight.frame * steps[flight.clip], flight.height) for flight in fit.flights]
    models = []
    for name in dict.fromkeys(["parabola", shape_name]):
        shape = fit.shapes[name]
        pieces, left = [], []
        for i, flight in enumerate(fit.flights):
            step = steps[flight.clip]
            grid = np.linspace(flight.frame[0], flight.frame[-1], _FLIGHT_GRID)
            pieces.append(
                (grid * step, shape.seen(shape.apex_height[i] - shape.law.drop_m(grid - shape.apex_frame[i])))
            )
            seen = shape.seen(shape.apex_height[i] - shape.law.drop_m(flight.frame - shape.apex_frame[i]))
            left.append((flight.frame * step, flight.height - seen))
        models.append(ModelCurve(f"{name}, rms {shape.sigma:.2f}", pieces, left))
    unit = "time in the file (s)" if step_s[0] else "frame"
    return FitPlot(unit, "height (file's unit)", "measured - fitted", data, models, [f.clip for f in fit.flights])
