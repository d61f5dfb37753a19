"""Times of a recording on the clock that played its drive, by the recording's map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Floats, Integers


def played_s(times_s: Floats, rows: NDArray[np.void], gaps: Integers, rate_hz: float) -> Floats:
    """Times on a recording's axis as times on the clock that played the drive.

    Parameters
    ----------
    times_s
        On the recording's own axis: frame ``n`` is ``n / rate_hz``, lost ones not counted.
    rows
        Its map, `MAP_DTYPE`: between two rows the cubic through lags and rates.
    gaps
        Its gaps ``(n, 2)``: first sample after the gap, samples lost.
    rate_hz
        Nominal rate of both clocks.
    """
    sample = np.asarray(times_s) * rate_hz
    if len(gaps):
        lost = np.concatenate([[0], np.cumsum(gaps[:, 1])])
        sample = sample + lost[np.searchsorted(gaps[:, 0], sample, side="right")]
    at, lag = rows["recorded_sample"].astype(np.float64), rows["played_sample"] - rows["recorded_sample"]
    if len(rows) == 1:
        return np.asarray((sample + lag[0] + (sample - at[0]) * rows["rate"][0]) / rate_hz)
    k = np.clip(np.searchsorted(at, sample) - 1, 0, len(at) - 2)
    h = at[k + 1] - at[k]
    u = np.clip((sample - at[k]) / h, 0.0, 1.0)
    r0, r1 = rows["rate"][k] * h, rows["rate"][k + 1] * h
    inside = (
        lag[k] * (1 + 2 * u) * (1 - u) ** 2 + r0 * u * (1 - u) ** 2
        + lag[k + 1] * u**2 * (3 - 2 * u) - r1 * u**2 * (1 - u)
    )  # fmt: skip
    beyond = (sample - np.clip(sample, at[0], at[-1])) * np.where(sample < at[0], rows["rate"][0], rows["rate"][-1])
    return np.asarray((sample + inside + beyond) / rate_hz)
