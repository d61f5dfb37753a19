"""The table of a report with a row for each step: set and reached, measured and predicted, error before and after."""

from __future__ import annotations

import math

from analysis.report.figures.loop import by_step
from analysis.report.figures.measured import Measured
from analysis.report.gamma import GammaScale
from analysis.report.numbers import fixed
from analysis.statistics import mad_sigma

HEADS = (
    "step", "gamma set", "reached", "+-", "measured", "model", "flights", "mean flight time (ms)", "over model",
    "rms to model (us)",
)  # fmt: skip
ERRORS = ("landing error before (us)", "after (us)")


def step_table(shown: Measured, scale: GammaScale) -> tuple[list[str], list[list[str]]] | None:
    """Headings and rows, held-out steps with a star; errors are robust. None where no flight was seen."""
    loop = shown.loop
    if shown.compared is None:
        return None
    held = set(loop.held_out) if loop is not None else set()
    errors = [] if loop is None else [
        dict(zip(loop.steps.number.tolist(), by_step(loop, side.landing_residual_s, mad_sigma), strict=True))
        for side in (loop.flights.before, loop.flights.after)
    ]  # fmt: skip
    rows = []
    for own in shown.compared.steps:
        plate, stated = shown.flights.plate.steps[own.step], shown.recording.steps[own.step]
        cells = [
            f"{own.step}{'*' if own.step in held else ''}",
            fixed(scale.factor * float(stated["gamma"]), 4),
            fixed(scale.factor * own.gamma, 4),
            fixed(scale.factor * plate.gamma_uncertainty if plate is not None else math.nan, 4),
            own.measured.label,
            own.predicted,
            str(own.measured.flights),
            fixed(1e3 * own.measured.mean_s, 3),
            fixed(own.mean_ratio, 4),
            fixed(1e6 * own.rms_s, 1) + (f" ({own.unfit_reason})" if own.unfit_reason else ""),
        ]
        rows.append([*cells, *(fixed(of_side.get(own.step, math.nan), 1) for of_side in errors)])
    heads = [head.replace("gamma", scale.name) for head in HEADS] + (list(ERRORS) if loop is not None else [])
    return heads, rows
