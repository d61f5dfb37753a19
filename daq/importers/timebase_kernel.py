"""Passes over times: sums and extremes in one go, without an array for each operation between."""

from __future__ import annotations

import numpy as np

from kernels import njit


@njit(error_model="numpy")
def to_nanoseconds(raw, origin, factor, last_s, longest_s, stamps):  # type: ignore[no-untyped-def]
    """Fill in nanoseconds since ``origin``; whether one is too far from it, one falls, one equals that before.

    ``last_s`` is the time before the first, in seconds since the origin. The last one comes back, too.
    """
    far = falls = same = False
    before = last_s
    for i in range(raw.shape[0]):
        seconds = (raw[i] - origin) * factor
        far |= not abs(seconds) < longest_s
        falls |= seconds < before
        same |= seconds == before
        stamps[i] = 0 if far else np.int64(np.rint(seconds * 1e9))
        before = seconds
    return far, falls, same, before


@njit(error_model="numpy")
def are_whole(values, scale):  # type: ignore[no-untyped-def]
    """Whether all values times ``scale`` are whole numbers, but for rounding."""
    for i in range(values.shape[0]):
        scaled = values[i] * scale
        if not abs(scaled - np.rint(scaled)) <= 1e-4 + 4e-16 * abs(scaled):
            return False
    return True


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def longest_step(seconds):  # type: ignore[no-untyped-def]
    """Largest difference of neighbours."""
    longest = -np.inf
    for i in range(seconds.shape[0] - 1):
        longest = max(longest, seconds[i + 1] - seconds[i])
    return longest


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def line_sums(seconds, first, centre, middle, sums):  # type: ignore[no-untyped-def]
    """Add to ``sums``: number, y, x y, x x, y y of samples from ``first`` on, x from ``centre``, y from ``middle``."""
    y_sum = xy = xx = yy = 0.0
    for i in range(seconds.shape[0]):
        x, y = first + i - centre, seconds[i] - middle
        y_sum += y
        xy += x * y
        xx += x * x
        yy += y * y
    sums += np.array([seconds.shape[0], y_sum, xy, xx, yy])


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def distances(seconds, first, origin, step):  # type: ignore[no-untyped-def]
    """Of times from sample ``first`` on, less those of an even grid: smallest, largest, sum, sum of squares."""
    low, high, total, square = np.inf, -np.inf, 0.0, 0.0
    for i in range(seconds.shape[0]):
        off = seconds[i] - origin - (first + i) * step
        low, high = min(low, off), max(high, off)
        total += off
        square += off * off
    return low, high, total, square
