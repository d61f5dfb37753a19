"""A reading that stands at its largest or smallest value: sensor or converter are at their end.

The tones of motion that is cut off are too small, and no fit can tell. Impacts that are cut off do no harm to a tone,
but they are not the waveform that other impacts have. Decision 310.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from kernels import njit
from kernels.arrays import Bools, Floats

STANDS = 0.02  # share of the samples at an end from which it saturates: a sine cut off there has lost 0.2 % of its peak
STANDS_S = 1e-3  # time at an end from which it is the motion that stands there: a table's ringing turns sooner
CROWDED = 3.0  # times as many in the outermost band as in the next one; where a sine turns there are 2.4 times as many

Ends = tuple[float, float]
NO_ENDS: Ends = (-math.inf, math.inf)


def ends_of(values: npt.NDArray[Any]) -> Ends:
    """Reading at or below which, and the one at or above which, the sensor is at its end; infinite where it is not.

    Noise behind the sensor spreads its end over a band: the outermost part of the readings' (n,) range is compared with
    the next one, for parts of several sizes.
    """
    x = np.asarray(values, dtype=np.float64)
    in_order = np.sort(values[:4096]).astype(np.float64)  # whole codes are sorted several times faster
    steps = np.diff(in_order)
    least = 2.0 * float(np.min(steps[steps > 0.0], initial=np.inf))
    least = least if least < math.inf else 0.0
    # noise may spread an end over so many parts of the range
    widths = [max(float(np.ptp(x)) / part, least) for part in (200.0, 100.0, 50.0, 25.0)]
    return -_end(-x, widths), _end(x, widths)


def _end(x: Floats, widths: list[float]) -> float:
    """Reading from which on the upper end is reached."""
    top = float(x.max())
    near = x[x > top - 2.0 * widths[-1]]
    for width in widths:
        at = near[near > top - width]
        next_to = np.count_nonzero(near > top - 2.0 * width) - at.size
        # four sigma of the counts: the readings crowd at an end
        if at.size - CROWDED * next_to > 4.0 * math.sqrt(at.size + CROWDED**2 * next_to):
            level = float(np.median(at))
            # readings within four standard deviations of the noise about an end are at the end
            return level - 4.0 * 1.4826 * float(np.median(at[at >= level] - level))
    return math.inf


def common_ends(stretches: Sequence[npt.NDArray[Any]], rate_hz: float) -> Ends:
    """Ends that some stretches of a sensor's readings, (n,) each, show, and beyond which no other one reads.

    Each stretch holds one motion: together, where weaker ones turn, there are as many readings as at an end. Impacts
    that are all alike have their peaks in as narrow a band, but do not stay there.
    """
    pairs, ends = [ends_of(x) for x in stretches], []
    for side, sign in enumerate((-1.0, 1.0)):
        tops = [float(np.max(sign * x)) for x in stretches]
        found = [sign * pair[side] for pair in pairs]
        held = [
            end for end, top, x in zip(found, tops, stretches, strict=True)
            # a reading far beyond, in another stretch, shows that this was a turning point of the motion, no end
            if max(tops) <= top + 0.5 * (top - end) and _stay(sign * x >= end) > max(1e-4 * rate_hz, 2.0)
        ]  # fmt: skip
        ends.append(sign * min(held, default=math.inf))
    return ends[0], ends[1]


def _stay(at_end: Bools) -> float:
    """Mean length of the unbroken runs of readings at an end."""
    runs = int(np.count_nonzero(at_end[1:] & ~at_end[:-1]))
    return np.count_nonzero(at_end) / max(runs, 1)


def share_at_an_end(values: npt.NDArray[Any], rate_hz: float, ends: Ends | None = None) -> float:
    """Share of ``values`` (n,) in stretches of `STANDS_S` or more at an end: of the motion, not only of impacts.

    ``ends`` are those of the same sensor in readings that go farther; None: of these values.
    """
    low, high = ends_of(values) if ends is None else ends
    return float(_standing(values, low, high, max(int(STANDS_S * rate_hz), 1))) / len(values)


def blocks_at_an_end(values: npt.NDArray[Any], width: int, skip: int, ends: Ends) -> Bools:
    """Which blocks of ``width`` values after the first ``skip`` hold one at an end, or are next to one that does."""
    out = np.zeros(max(len(values) - skip, 0) // width, dtype=np.bool_)
    _reach(values, width, skip, *ends, out)
    return out


@njit()
def _reach(values, width, skip, low, high, out):  # type: ignore[no-untyped-def]
    """Mark each block that holds a value at or below ``low``, or at or above ``high``, and its neighbours."""
    for i in range(skip, skip + out.shape[0] * width):
        if values[i] <= low or values[i] >= high:
            block = (i - skip) // width
            out[max(block - 1, 0) : block + 2] = True


@njit()
def _standing(values, low, high, least):  # type: ignore[no-untyped-def]
    """Values in unbroken stretches of ``least`` or more at or below ``low``, or at or above ``high``."""
    total = length = side = 0
    for i in range(values.shape[0] + 1):
        now = 0 if i == values.shape[0] else int(values[i] >= high) - int(values[i] <= low)
        if now != side:
            total += length if side != 0 and length >= least else 0
            side, length = now, 0
        length += 1
    return total
