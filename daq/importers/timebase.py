"""Time base of a foreign recording: one sample rate, pauses, or real jitter.

A column that is uniform up to its own rounding is uniform, and its rate is the one number that explains all of it; a
column that jitters is stored as it came, with the jitter stated. Compiled passes take sums and extremes in one go,
without an array for each operation between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kernels import njit
from kernels.arrays import Floats, Integers

JITTER_SHARE = 0.01  # of a sample: less is uniform for any purpose
PIECE = 1 << 18  # times read at once
Runs = list[tuple[int, int]]


@dataclass(frozen=True)
class Timebase:
    """Sampling of a time column."""

    rate_hz: float  # samples a second
    uniform: bool  # whether every time is where the rate says, up to the column's rounding (or 1 % of a sample)
    jitter_s: float  # root mean square distance from the even grid
    # int64 ``(n, 3)``: first sample after the pause, samples missing, standard uncertainty of that number
    gaps: Integers
    packet: int = 1  # rows that share each time of the column, and are evenly spaced all the same


Times = Callable[[int, int], Floats]
"""Gives seconds of samples ``start .. stop``, read again and again, never all at once."""


def timebase_of(times: Times, n: int, quantum_s: float) -> Timebase:
    """Rate, pauses and jitter of ``n`` times, at least 2, not falling; ``quantum_s``: rounding step of the column."""
    first = times(0, min(n, PIECE))
    stride = min(1000, max(1, (len(first) - 1) // 3))  # long, so that rounding does not bias the step
    # a step in time longer than this many samples is a pause
    limit = 1.6 * float(np.median(first[stride:] - first[:-stride])) / stride + quantum_s
    pauses = [np.zeros(0, np.int64)]
    for start in range(0, n - 1, PIECE):
        own = times(start, min(start + PIECE + 1, n))  # pieces overlap by a sample: every difference counts once
        if longest_step(own) > limit:
            pauses.append(start + 1 + np.flatnonzero(np.diff(own) > limit))
    gaps = np.concatenate(pauses).astype(np.int64)
    runs = list(pairwise([0, *gaps.tolist(), n]))
    slope, slope_sigma = _slope(times, n, runs)
    step = slope
    allowed = (0.5 * quantum_s + 1e-9) / max(n - 1 - len(gaps), 1)
    for digits in range(0, 7):  # the roundest rate that the column cannot distinguish from the fitted one
        rate = round(1.0 / slope, digits)
        if rate > 0 and abs(1.0 / rate - slope) <= allowed:
            step = 1.0 / rate
            break
    samples = np.array([float(np.diff(times(g - 1, g + 1))[0]) for g in gaps.tolist()]) / step  # of each pause
    sigma = np.hypot(samples * slope_sigma / step, quantum_s / step)
    found = np.stack([gaps, np.rint(samples) - 1, np.ceil(sigma - 0.5).clip(0)], axis=1).astype(np.int64)
    worst, rms = _distance(times, n, runs, step)
    uniform = bool(worst <= max(0.75 * quantum_s + 1e-9, JITTER_SHARE * step)) and not len(gaps)
    return Timebase(1.0 / step, uniform, rms, found[found[:, 1] > 0])


def of_packets(times: Times, n: int, quantum_s: float, near_hz: float) -> Timebase | None:
    """Time base of rows that a card stamps once a packet, each packet as many rows; None where they are not such.

    Packets may scatter by a quarter of their length; missing ones are pauses. The rate is ``near_hz`` where the stamps
    allow it.
    """
    starts, stamps = [np.zeros(1, np.int64)], [times(0, 1)]
    for start in range(0, n - 1, PIECE):
        own = times(start, min(start + PIECE + 1, n))
        new = 1 + np.flatnonzero(np.diff(own) > 0.0)
        starts.append(start + new)
        stamps.append(own[new])
    # the first packet and the last may be cut
    first, stamp_s = np.concatenate(starts)[1:], np.concatenate(stamps)[1:]
    length = int(first[1] - first[0]) if len(first) > 8 else 1
    if length == 1 or np.any(np.diff(first) != length):
        return None
    base = timebase_of(lambda a, b: stamp_s[a:b], len(stamp_s), quantum_s)
    if base.jitter_s * base.rate_hz > 0.25:
        return None
    lost = base.gaps[:, 1] * length
    gaps = np.column_stack([first[base.gaps[:, 0]], lost, np.zeros(len(lost), np.int64)])
    sigma = base.jitter_s * np.sqrt(12.0 / len(stamp_s)) / (stamp_s[-1] - stamp_s[0])
    rate_hz = base.rate_hz * length
    rate_hz = near_hz if abs(rate_hz / near_hz - 1.0) < 3.0 * sigma else rate_hz
    return Timebase(rate_hz, True, base.jitter_s, gaps, length)


def quantum_of(values: Floats) -> float:
    """Rounding step of a column: the coarsest power of ten that all its values are multiples of; inf if none is."""
    for exponent in range(10):
        if are_whole(values, 10.0**exponent):
            return float(10.0**-exponent)
    return float("inf")


def _slope(times: Times, n: int, runs: Runs) -> tuple[float, float]:
    """Seconds a sample by least squares within the unbroken runs, with its standard deviation."""
    sxy = sxx = ss = 0.0
    own: list[tuple[float, float]] = []
    for start, stop in runs:
        centre, middle = (stop - start - 1) / 2.0, float(np.mean([times(start, start + 1), times(stop - 1, stop)]))
        sums = np.zeros(5)
        for a in range(start, stop, PIECE):
            line_sums(times(a, min(a + PIECE, stop)), a - start, centre, middle, sums)
        sxy, sxx = sxy + sums[2], sxx + sums[3]
        own.append((sums[2], sums[3]))
        ss += sums[4] - sums[1] ** 2 / sums[0]
    slope = sxy / sxx
    variance = max(ss - slope * sxy, 0.0) / max(n - 2 * len(runs), 1)
    # a clock that wanders from run to run shows in the runs' own slopes, not in the residuals
    wander = sum(w * (xy / w - slope) ** 2 for xy, w in own if w > 0) / sxx
    return slope, float(np.sqrt(variance / sxx + wander))


def _distance(times: Times, n: int, runs: Runs, step: float) -> tuple[float, float]:
    """Largest and rms distance of the times from an even grid through each unbroken run."""
    worst = squares = 0.0
    for start, stop in runs:
        low, high, total, square = np.inf, -np.inf, 0.0, 0.0
        origin = float(times(start, start + 1)[0])
        for a in range(start, stop, PIECE):
            least, most, own, squared = distances(times(a, min(a + PIECE, stop)), a - start, origin, step)
            low, high, total, square = min(low, least), max(high, most), total + own, square + squared
        worst = max(worst, (high - low) / 2.0)
        squares += max(square - total**2 / (stop - start), 0.0)
    return worst, float(np.sqrt(squares / n))


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
