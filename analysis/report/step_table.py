"""The table of a report with a row for each step: set and reached, measured and predicted, error before and after."""

from __future__ import annotations

import html
import math

import numpy as np

from analysis.flights.compare import Comparison
from analysis.flights.table import Flights
from analysis.loop.result import ClosedLoop, Predictions
from analysis.report.gamma import GammaScale
from analysis.report.page import plain_html
from daq.recording import Recording

HEADS = (
    "step", "gamma set", "reached", "+-", "measured", "model", "flights", "mean flight time (ms)", "over model",
    "rms to model (µs)",
)  # fmt: skip
ERRORS = ("landing error before (µs)", "after (µs)")


def step_table(
    recording: Recording, compared: Comparison, loop: ClosedLoop | None, scale: GammaScale, flights: Flights
) -> str:
    """The table as HTML; errors are robust, and a star marks held-out steps."""
    before, after, held = _errors_by_step(loop)
    heads = [h.replace("gamma", scale.name) for h in HEADS] + (list(ERRORS) if loop is not None else [])
    rows = []
    for own in compared.steps:
        plate, stated = flights.plate.steps[own.step], recording.steps[own.step]
        cells = [
            f"{own.step}{'*' if own.step in held else ''}",
            _number(scale.factor * float(stated["gamma"]), 4),
            _number(scale.factor * own.gamma, 4),
            _number(scale.factor * plate.gamma_uncertainty if plate is not None else math.nan, 4),
            own.measured.label,
            own.predicted,
            str(own.measured.flights),
            _number(1e3 * own.measured.mean_s, 3),
            _number(own.mean_ratio, 4),
            _number(1e6 * own.rms_s, 1) + (f" ({own.unfit_reason})" if own.unfit_reason else ""),
        ]
        if loop is not None:
            cells += [_number(before.get(own.step, math.nan), 1), _number(after.get(own.step, math.nan), 1)]
        rows.append("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in cells) + "</tr>")
    head = "".join(f"<th>{plain_html(h)}</th>" for h in heads)
    body = "".join(rows)
    note = "*: held out; never fitted. Errors are robust (1.4826 times the median of their size)."
    return (
        f"<div class='wide'><table class='small steps'><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>" + (f"<p class='meta'>{note}</p>" if held else "")
    )


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _errors_by_step(loop: ClosedLoop | None) -> tuple[dict[int, float], dict[int, float], set[int]]:
    """Robust landing errors in microseconds by the step's number, before and after, and the held-out numbers."""
    if loop is None:
        return {}, {}, set()

    def errors(side: Predictions) -> dict[int, float]:
        out = {}
        for row, number in enumerate(loop.steps.number):
            x = side.landing_residual_s[(loop.flights.step == row) & loop.flights.scored]
            x = x[np.isfinite(x)]
            if len(x):
                out[int(number)] = 1.4826e6 * float(np.median(np.abs(x)))
        return out

    return errors(loop.flights.before), errors(loop.flights.after), set(loop.held_out)
