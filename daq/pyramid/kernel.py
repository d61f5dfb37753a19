"""Minima and maxima of stretches of samples, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernels import njit


@njit(nogil=True)
def fold_samples(codes: NDArray[Any], skipped: int, bucket: int, low: NDArray[Any], high: NDArray[Any]) -> None:
    """Widen the extremes ``low``, ``high`` (k,) of buckets by samples (n,) that do not jump over lost ones.

    Parameters
    ----------
    codes
        Samples; one that is no number (NaN) is passed over.
    skipped
        Samples of the first bucket that came before.
    bucket
        Samples a bucket.
    low, high
        Extremes so far; ``low > high``: none yet.
    """
    at, k, n = 0, 0, len(codes)
    end = min(bucket - skipped, n)
    while at < n:
        least, most = low[k], high[k]
        for i in range(at, end):
            x = codes[i]
            least = x if x < least else least
            most = x if x > most else most
        low[k], high[k] = least, most
        at, end, k = end, min(end + bucket, n), k + 1


@njit(nogil=True)
def fold_buckets(
    low: NDArray[Any],
    high: NDArray[Any],
    begins: NDArray[np.int64],
    ends: NDArray[np.int64],
    into_low: NDArray[Any],
    into_high: NDArray[Any],
) -> None:
    """Extremes (k,) of the buckets ``begins[k]`` to ``ends[k]`` (exclusive) of ``low``, ``high``."""
    for k in range(len(begins)):
        least, most = low[begins[k]], high[begins[k]]
        for i in range(begins[k] + 1, ends[k]):
            least = low[i] if low[i] < least else least
            most = high[i] if high[i] > most else most
        into_low[k], into_high[k] = least, most


@njit(nogil=True)
def widen(
    low: NDArray[Any], high: NDArray[Any], column: NDArray[np.int64], into_low: NDArray[Any], into_high: NDArray[Any]
) -> None:
    """Widen the extremes of columns of a picture by buckets, or samples, that fall into ``column`` (n,) each."""
    for i in range(len(column)):
        k = column[i]
        if 0 <= k < len(into_low):
            into_low[k] = low[i] if low[i] < into_low[k] else into_low[k]
            into_high[k] = high[i] if high[i] > into_high[k] else into_high[k]
