"""Description of a discovered curve in one sentence, between the outer knots, where there are data."""

from __future__ import annotations

import numpy as np

from analysis.discovery.terms import Curve, label

POINTS = 61  # at which the curve is evaluated
MOSTLY = 0.8  # share of the range that the ends of a rise or fall must span; share that happens in a narrow part


def describe(curve: Curve) -> str:
    """One sentence, as "dry friction rises from 0.01 g to 0.1 g between a height of 0 mm and 4.2 mm"."""
    words, unit, scale = label(curve.term)
    x = np.linspace(curve.knots[0], curve.knots[-1], POINTS)
    y = curve.at(x)
    name = curve.term.words
    if curve.term.name == "force":
        y = y if curve.term.columns else -y
        name = "a downward pull" if abs(np.max(y)) >= abs(np.min(y)) else "an upward push"
        y = y if name == "a downward pull" else -y
    span = float(np.ptp(y))
    if span <= 0.0:
        return f"{name} is {_number(y[0], curve.term.unit)} whatever the {words}"

    def place(i: int) -> str:
        return _number(scale * float(x[i]), unit)

    def level(i: int) -> str:
        return _number(float(y[i]), curve.term.unit)

    top, bottom = int(np.argmax(y)), int(np.argmin(y))
    if abs(y[-1] - y[0]) >= MOSTLY * span:
        # the ends of the middle `MOSTLY` of the rise or fall
        part, rest = (y - y[0]) / (y[-1] - y[0]), 0.5 * (1.0 - MOSTLY)
        first, last = int(np.argmax(part >= rest)), int(np.argmax(part >= 1.0 - rest))
        verb = "rises" if y[-1] > y[0] else "falls"
        text = f"{name} {verb} from {level(0)} to {level(-1)} as {words} goes from {place(0)} to {place(-1)}"
        narrow = last - first < 0.4 * POINTS
        return text + (f", mostly between {place(first)} and {place(last)}" if narrow else "")
    if y[top] - max(y[0], y[-1]) >= min(y[0], y[-1]) - y[bottom]:
        peak = f"{name} is greatest, {level(top)}, where {words} is about {place(top)}"
        return f"{peak}, and {level(bottom)} at {place(bottom)}"
    return f"{name} is least, {level(bottom)}, where {words} is about {place(bottom)}, and {level(top)} at {place(top)}"


def _number(value: float, unit: str) -> str:
    text = f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"
    return text if unit in ("", "1") else f"{text} {unit}"
