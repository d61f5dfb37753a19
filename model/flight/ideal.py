"""One ideal flight, compiled: the first landing, proven first, and the next take-off.

A landing is returned only when every earlier branch of the flight (`model.flight.branches`) is
proven free of roots (`model.flight.segment`).
"""

from __future__ import annotations

import math

from kernels.arrays import Floats
from model.flight.branches import TWO_PI, branch_of, fold, q_and_slope
from model.flight.numerics import compiled
from model.flight.records import Segment
from model.flight.segment import UNDECIDED, motion, root_in_concave, root_in_convex, shape, surely_above

RESTS = 4  # the ball does not leave at this phase
TINY = 1e-7  # a window left sooner than this may have lifted the ball by less than rounding


@compiled
def _guess_in_concave(segment: Segment, lo: float, hi: float, h_hi: float, h1_hi: float) -> float:
    """Where a parabola through the branch's end, with the slope there and the full pull, crosses zero."""
    pull = -0.5 * segment.pull
    root = math.sqrt(max(h1_hi * h1_hi - 4.0 * pull * h_hi, 0.0))
    return max(hi + 2.0 * h_hi / (root - h1_hi), lo)


@compiled
def _land_below_threshold(tones: Floats, gamma: float, segment: Segment) -> tuple[float, float, float, int]:
    """`land` where the plate never lifts a ball: the flight is concave for ever, any point below ends the bracket."""
    phi0 = segment.phase
    reach = 1.0
    while motion(tones, gamma, segment, phi0 + reach, reach)[0] > 0.0:
        reach *= 2.0
    x, speed = root_in_concave(tones, gamma, segment, 0.0, phi0, phi0 + reach, phi0 + min(2.0 * segment.speed, reach))
    return x - phi0, x, speed, 0


@compiled
def land(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, phi0: float, a0: float, v0: float
) -> tuple[float, float, float, int]:
    """The first landing after the take-off at the folded phase ``phi0``.

    Parameters
    ----------
    tones, edge, n_windows
        A periodic forcing and its table (`model.flight.branches.fill_edges`).
    gamma : float
        Drive amplitude.
    phi0 : float
        Take-off phase in ``[edge[0], edge[0] + 2 pi)``.
    a0 : float
        ``gamma q(phi0) - 1``; exactly 0 at a threshold.
    v0 : float
        Speed relative to the plate, >= 0; with 0 the phase must be inside a window.

    Returns
    -------
    tau, landing phase (folded into the period of ``edge``), impact speed, flag
    """
    s0, slope0, _ = shape(tones, phi0)
    segment = Segment(phi0, s0, slope0, a0, v0, 0.0, 1.0)
    if n_windows == 0:
        return _land_below_threshold(tones, gamma, segment)
    safe_from, safe_to = surely_above(tones, gamma, segment)
    i = branch_of(edge, n_windows, phi0)
    turns, lo, slope_lo, flag = 0.0, phi0, v0, 0
    if i % 2 == 0:  # lifted through the rest of the window
        lo = edge[i + 1]
        tau = lo - phi0
        if tau < TINY and motion(tones, gamma, segment, lo, tau)[0] <= 0.0:  # by less than rounding
            return 3.0 * tau, fold(phi0 + 3.0 * tau, edge[0]), 0.0, UNDECIDED
        i += 1
    while True:
        if i % 2 == 1:
            hi = edge[i + 1]
            h, slope_lo, _ = motion(tones, gamma, segment, hi, hi - phi0 + turns)
            if h <= 0.0:
                guess = _guess_in_concave(segment, lo, hi, h, slope_lo)
                x, speed = root_in_concave(tones, gamma, segment, turns, lo, hi, guess)
                return x - phi0 + turns, x, speed, flag
            tau = hi - phi0 + turns
            if safe_from < tau < safe_to - TWO_PI:
                skipped = TWO_PI * math.floor((safe_to - tau) / TWO_PI)
                turns += skipped
                slope_lo -= skipped
        elif slope_lo < 0.0:
            found, x, speed, graze = root_in_convex(tones, gamma, segment, turns, edge[i], edge[i + 1])
            flag |= graze
            if found:
                return x - phi0 + turns, x, speed, flag
        i += 1
        if i == 2 * n_windows:
            i = 0
            turns += TWO_PI
        lo = edge[i]


@compiled
def next_take_off(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, phi: float
) -> tuple[float, float, int, bool]:
    """Where a ball at rest at the folded phase ``phi`` leaves: ``(phase, a0, window, reset)``.

    At once inside a window (``reset`` False, ``window`` -1), else at the next threshold, where ``a0 = 0``.
    """
    i = branch_of(edge, n_windows, phi)
    if i % 2 == 0 and phi > edge[i]:
        return phi, max(gamma * q_and_slope(tones, phi)[0] - 1.0, 0.0), -1, False
    window = ((i + 1) // 2) % n_windows
    return edge[2 * window], 0.0, window, True
