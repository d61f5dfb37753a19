"""One form for every kind of number: for pages, figures and terminal."""

from __future__ import annotations

import math

BELOW = 1e-4  # a number smaller than this is written with an exponent


def interval(value: float, low: float, high: float) -> str:
    """A value with its interval, all to the same place: two significant digits of half the interval's width.

    Example: ``0.1178 (0.1100 .. 0.1255)``.
    """
    if not all(math.isfinite(x) for x in (value, low, high)):
        return f"{value:.4g} ({low:.4g} .. {high:.4g})"
    half, largest = 0.5 * (high - low), max(abs(value), abs(low), abs(high))
    place = 1 - math.floor(math.log10(half)) if half > 0.0 else 6
    if 0.0 < largest < BELOW:
        exponent = math.floor(math.log10(largest))
        digits = max(place + exponent, 0)
        shown = [f"{x / 10.0**exponent:.{digits}f}e{exponent}" for x in (value, low, high)]
    else:
        shown = [f"{x:.{min(max(place, 0), 9)}f}" for x in (value, low, high)]
    return f"{shown[0]} ({shown[1]} .. {shown[2]})"


def fixed(value: float, digits: int) -> str:
    """A number with so many decimals; a dash where there is none."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def microseconds(value: float) -> str:
    """Microseconds to a tenth, without a unit; a dash where there is none."""
    return fixed(value, 1)


def probability(p: float) -> str:
    """A probability as ``p = 0.03``; below 1e-9 as a bound."""
    return f"p = {p:.2g}" if p >= 1e-9 else "p < 1e-9"


def plus_minus(value: float, sigma: float) -> str:
    """A value with its standard deviation, both to the second significant digit of the latter."""
    if not (math.isfinite(value) and math.isfinite(sigma) and sigma > 0.0):
        return f"{value:.4g}"
    if max(abs(value), sigma) < BELOW:
        return f"{value:.2e} +- {sigma:.1e}"
    place = min(max(1 - math.floor(math.log10(sigma)), 0), 9)
    return f"{value:.{place}f} +- {sigma:.{place}f}"
