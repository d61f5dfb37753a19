"""Readings that are held, or rounded more coarsely than the noise.

A sensor is slower than the recording, or a table was filled with the value before: such a channel is a stair, whose
steps look like impacts. Decision 727. So is one of few bits. Decision 765.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from kernels import njit

RHYTHM_FRAME = 4096  # samples in which the rhythm of new readings is looked for


def held_samples(stretches: Sequence[npt.NDArray[Any]]) -> float:
    """Samples for which a channel holds each of its readings; 1 where it does not.

    Rounding alone makes equal neighbours, too, but new readings then come without a rhythm. Of each stretch of codes or
    volts (n,) the first `RHYTHM_FRAME` samples count.
    """
    holds = []
    for values in stretches:
        new = np.diff(values[: RHYTHM_FRAME + 1]) != 0
        count = int(np.count_nonzero(new))
        holds.append(1.0)
        if new.size < RHYTHM_FRAME or not 20 <= count <= 0.7 * RHYTHM_FRAME:  # fewer tell no rhythm
            continue
        rhythm = np.abs(np.fft.rfft((new - new.mean()) * np.hanning(RHYTHM_FRAME))) / (0.5 * count)
        rhythm[:20] = 0.0  # no stair of so many readings at least, but a part in which the channel was dead
        # a stair of whole samples has all its overtones: the lowest counts
        line = 1 + int(np.argmax(rhythm[1:] > 0.7 * rhythm[1:].max()))
        # more readings than every other sample beat at what is left to the sampling rate
        of_all = RHYTHM_FRAME - line if 2 * count > RHYTHM_FRAME else line
        sooner = np.mean(np.diff(np.flatnonzero(new)) < RHYTHM_FRAME // of_all)
        # holds of 1.5 samples, rounded to whole ones, keep .33 of the rhythm, chance makes .04; steps of a coarsely
        # rounded motion are fewer, or come too soon where it flickers between two readings
        if rhythm[line] > 0.25 and sooner < 0.01 and count > 0.4 * of_all:
            holds[-1] = RHYTHM_FRAME / of_all
    typical = float(np.median(holds)) if holds else 1.0
    # noise and motion change along a recording, a sensor's clock does not
    alike = [abs(RHYTHM_FRAME / hold - RHYTHM_FRAME / typical) < 2.0 for hold in holds]
    return typical if 2 * sum(alike) > len(alike) else 1.0


def without_stair(volts: npt.NDArray[Any], held: float) -> None:
    """Replace a stair (n,) whose readings are held for ``held`` samples by a smooth line through them, in place."""
    if held > 1.0:
        _join(volts)
        width = round(held)
        for _ in range(3):  # an impact then looks alike wherever in a hold it falls
            sums = np.concatenate([[0.0], np.cumsum(np.pad(volts.astype(np.float64), width, mode="edge"))])
            means = (sums[width:] - sums[:-width]) / width
            # means over an even number of samples lie between two
            both = means if width % 2 else 0.5 * (means[1:] + means[:-1])
            first = (both.size - volts.size) // 2
            volts[:] = both[first : first + volts.size]


@njit()
def _join(volts):  # type: ignore[no-untyped-def]
    """Draw straight lines between the first samples of the steps of a stair (n,), in place."""
    begin = 0
    for i in range(1, volts.shape[0]):
        if volts[i] != volts[i - 1]:
            low, rise = volts[begin], (volts[i] - volts[begin]) / (i - begin)
            for k in range(begin + 1, i):
                volts[k] = low + rise * (k - begin)
            begin = i


def coarse_step(stretches: Sequence[npt.NDArray[Any]]) -> float:
    """Distance of neighbouring readings of a channel that is rounded more coarsely than its noise; 0 where it is not.

    Most readings, of the first `RHYTHM_FRAME` of stretches (n,) in codes or volts, then equal the one before.
    """
    changes = np.concatenate([np.zeros(0), *(np.abs(np.diff(x[:RHYTHM_FRAME].astype(np.float64))) for x in stretches)])
    few = changes[changes > 0.0]
    return float(np.median(few)) if 20 <= few.size < 0.4 * changes.size else 0.0


@njit()
def without_rounding(volts, step):  # type: ignore[no-untyped-def]
    """Draw straight lines through a rounded motion (n,), in place, between the middles of its steps of one ``step``.

    There the motion passed the border of two readings. Larger steps are an impact's: their samples stay.
    """
    n, begin, value, last = volts.shape[0], 0.0, volts[0], volts[0]
    for i in range(1, n + 1):
        here = volts[min(i, n - 1)]
        size = abs(here - last)
        if size > 0.5 * step or i == n:
            small = 0.5 * step < size < 1.5 * step
            end, reached = (i - 0.5, 0.5 * (last + here)) if small else (i - 1.0, last)
            for k in range(math.ceil(begin), i):
                volts[k] = value + (reached - value) * ((k - begin) / max(end - begin, 0.5))
            begin, value = (end, reached) if small else (float(i), here)
        last = here
