"""Sample rates that no recording of this rig can have: refused, with what to do about it.

A file is refused where going on would give wrong numbers without a word; what is merely odd is a
remark (`daq.importers.diagnostics`).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.columns import TIME_UNITS_S, Column
from daq.importers.timebase import Times
from daq.setup.errors import InputError
from daq.setup.setup import Setup

OTHER_UNIT = (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)  # ratio of two rates whose times are in two units
SAME_RATE = 0.02
MIXED = 1.05  # ratio of the fastest to the slowest part of a file beyond which no one rate describes it
_PARTS = 32
_LEAST_ROWS = 16  # of a part


def refuse_other_unit(path: Path, time: Column, rate_hz: float, setup: Setup) -> None:
    """Refuse times that are in another unit, by the sample rate that the profile states.

    Raises
    ------
    InputError
        Where the rate is the profile's by a power of a thousand.
    """
    if not setup.sampling.stated:
        return
    ratio = rate_hz / setup.sampling.rate_hz
    for other in OTHER_UNIT:
        if abs(ratio / other - 1.0) < SAME_RATE:
            unit_s = TIME_UNITS_S[time.unit or "s"] * other
            right = next((name for name, size in TIME_UNITS_S.items() if abs(size / unit_s - 1.0) < 1e-9), "")
            said = f"is it in {right} (--map time={time.name}:{right})" if right else "is its unit right"
            raise InputError(
                f"{path}: column {time.name} in {time.unit or 's'} gives {rate_hz:.6g} samples/s, profile "
                f"{setup.name!r} says {setup.sampling.rate_hz:.6g}; {said}? If not, correct sampling.rate_hz."
            )


def refuse_mixed_rates(path: Path, times: Times, n: int, quantum_s: float) -> None:
    """Refuse a file whose parts were sampled at different rates.

    Parameters
    ----------
    path
        Named in the error.
    times
        Seconds, not falling.
    n
        How many, at least 2.
    quantum_s
        Rounding step of the column.

    Raises
    ------
    InputError
        With the two rates, and the row near which they meet.
    """
    parts = min(_PARTS, n // _LEAST_ROWS)
    if parts < 2:
        return
    edges = np.linspace(0, n, parts + 1).astype(np.int64)
    # a median lies between the extremes: where these are alike everywhere, none need be found
    spans = np.array([_step(times, a, b, quantum_s, _extremes) for a, b in pairwise(edges.tolist())])
    if 0.0 < spans.max() < MIXED * spans.min():
        return
    steps = np.array([_step(times, a, b, quantum_s, np.median) for a, b in pairwise(edges.tolist())])
    slowest, fastest = float(steps.max()), float(steps.min())
    if fastest <= 0.0 or slowest < MIXED * fastest:
        return
    middle = np.sqrt(slowest * fastest)
    change = 1 + int(np.argmax((steps[1:] > middle) != (steps[:-1] > middle)))
    raise InputError(
        f"{path}: sampled at mixed rates: {1.0 / steps[change - 1]:.6g} samples/s before row {edges[change]} or so, "
        f"{1.0 / steps[change]:.6g} after; wanted one rate: import each part from a file of its own."
    )


def _step(times: Times, start: int, stop: int, quantum_s: float, of: Callable[[NDArray[Any]], Any]) -> Any:
    """Seconds between samples, by strides long enough that rounding does not bias them: ``of`` (median, ...) them."""
    own = times(start, min(stop, start + (1 << 16)))
    mean = float(own[-1] - own[0]) / (len(own) - 1)
    stride = int(min(np.ceil(50.0 * quantum_s / max(mean, 1e-12)), len(own) // 4))
    stride = max(stride, 1)
    return of(own[stride:] - own[:-stride]) / stride


def _extremes(values: NDArray[Any]) -> NDArray[Any]:
    """Smallest and largest."""
    return np.array([values.min(), values.max()])
