"""Texts of a logarithmic axis: plain numbers, and powers of ten where those would be long; no formulas to parse."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.ticker import FuncFormatter, LogFormatter

MINUS = "\u2212"  # as wide as a plus
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def plain_decades(axis: Any) -> None:
    """Write the ticks of a logarithmic axis as plain numbers: 0.01, 100; very small or large ones as powers of ten."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: plain_number(value)))
    if axis.get_scale() == "log":
        axis.set_minor_formatter(_Minor())


def plain_number(value: float) -> str:
    """The text of the tick at ``value``."""
    power = math.log10(abs(value)) if value else 0.0
    sign = MINUS if value < 0.0 else ""
    if not -4.0 < power < 6.0 and math.isclose(power, round(power)):
        return f"{sign}10{str(round(power)).translate(SUPERSCRIPTS)}"
    return f"{sign}{abs(value):g}"


class _Minor(LogFormatter):
    """Names those ticks between decades that matplotlib names: on axes of about a decade."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The text of the tick at ``x``; empty for most."""
        return plain_number(x) if super().__call__(x, pos) else ""
