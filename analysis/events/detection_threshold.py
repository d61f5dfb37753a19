"""Threshold of a detector from its own output where nothing happens, for a stated rate of false alarms."""

from __future__ import annotations

import numpy as np

from kernels.arrays import Floats

TAIL = 3.0  # standard deviations from which a detector's output counts as its tail
FALSE_PER_HOUR = 0.1  # impacts that noise may make in an hour of recording


def scale_and_threshold(quiet: Floats, rate_hz: float) -> tuple[float, float]:
    """Standard deviation of a detector's output where nothing happens, and its threshold in that unit.

    The tail beyond `TAIL` standard deviations is taken as exponential in the square, as a normal distribution's is,
    with the decay that the output shows. The threshold lets `FALSE_PER_HOUR` of its maxima pass in an hour.

    Parameters
    ----------
    quiet : array, shape (n,)
        Output of a filter, in the order of time.
    rate_hz : float
        Outputs a second.
    """
    deviation = np.abs(quiet)
    if deviation.size < 1024:
        return 1.0, 0.0
    # all but the largest 2 %, of rms 0.9346 for normal noise: robust, and unbiased by quantisation
    scale = float(np.sqrt(np.mean(deviation[deviation <= np.quantile(deviation[::8], 0.98)] ** 2))) / 0.9346
    up = quiet[1:-1]
    tops = up[(up > TAIL * scale) & (up >= quiet[:-2]) & (up > quiet[2:])] / scale
    decay, per_hour = 1.0, max(tops.size, 1) / quiet.size * rate_hz * 3600.0
    if tops.size:
        measured = float(np.median(tops**2 - TAIL**2)) / (2.0 * np.log(2.0))
        # a tail that is heavier by less than three standard errors is taken for that of normal noise
        decay = measured if measured > 1.0 + 3.0 * measured / np.sqrt(tops.size) else 1.0
    return scale, float(np.sqrt(TAIL**2 + 2.0 * decay * np.log(max(per_hour / FALSE_PER_HOUR, 1.0))))
