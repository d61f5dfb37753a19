"""Readings that a channel holds: its sensor is slower than the recording, or a table was filled with the value before.

Between two readings such a channel is a stair, whose steps look like impacts. Decision 727.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from kernels import njit

FRAME = 4096  # samples in which the rhythm of new readings is looked for
LEAST_RHYTHM = 0.25  # of the new readings that fall on it: 1.5 samples, rounded to whole ones, leave .33, chance .04
FEWEST = 20  # new readings in a frame that tell a rhythm
SMOOTHINGS = 3  # running means over one hold: an impact then looks alike wherever in a hold it falls


def held_samples(stretches: Sequence[npt.NDArray[Any]]) -> float:
    """Samples for which a channel holds each of its readings; 1 where it does not.

    Rounding alone makes equal neighbours, too, but new readings then come without a rhythm.

    Parameters
    ----------
    stretches
        Codes or volts, (n,) each; of each the first `FRAME` samples count.
    """
    holds = []
    for values in stretches:
        new = np.diff(values[: FRAME + 1]) != 0
        count = int(np.count_nonzero(new))
        holds.append(1.0)
        if new.size < FRAME or not FEWEST <= count <= 0.7 * FRAME:
            continue
        rhythm = np.abs(np.fft.rfft((new - new.mean()) * np.hanning(FRAME))) / (0.5 * count)
        # a stair of whole samples has all its overtones: the lowest counts
        line = int(np.argmax(rhythm > 0.7 * rhythm.max()))
        # more readings than every other sample beat at what is left to the sampling rate
        of_all = FRAME - line if 2 * count > FRAME else line
        sooner = np.mean(np.diff(np.flatnonzero(new)) < FRAME // of_all)
        # steps of a coarsely rounded motion are fewer, or come too soon where it flickers between two readings
        if rhythm[line] > LEAST_RHYTHM and sooner < 0.01 and count > 0.4 * of_all:
            holds[-1] = FRAME / of_all
    typical = float(np.median(holds)) if holds else 1.0
    # noise and motion change along a recording, a sensor's clock does not
    alike = [abs(FRAME / hold - FRAME / typical) < 2.0 for hold in holds]
    return typical if 2 * sum(alike) > len(alike) else 1.0


def without_stair(volts: npt.NDArray[Any], held: float) -> None:
    """Replace a stair (n,) whose readings are held for ``held`` samples by a smooth line through them, in place."""
    if held > 1.0:
        _join(volts)
        width = round(held)
        for _ in range(SMOOTHINGS):
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
