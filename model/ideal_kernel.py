"""One ideal flight, compiled: the first landing, proven first.

The height above the plate after a take-off at ``phi0`` with relative speed ``v0`` (the paper's eq. 4 at 0) is

    h(tau) = gamma [s(phi0) - s(phi0 + tau)] + gamma s'(phi0) tau + v0 tau - tau^2 / 2,
    s(phi) = sum_j b_j sin(n_j phi + p_j).

The rule kept here: a landing is returned only when every earlier branch (see `model.branches`) is proven free of roots.
A concave branch entered above the plate holds a root only if it ends below, and then one; in a convex one Newton from
the left cannot pass the first root, and ``h > 0`` with ``h' >= 0`` proves there is none.
"""

from __future__ import annotations

import math

import numpy as np

from model.branches import TWO_PI, branch_of, fill_edges, fold, q_and_slope
from model.compiled import Flags, Floats, compiled

RESET = 1  # this flight started from rest at a threshold
UNDECIDED = 2  # a graze closer than double precision can tell
RESTS = 4  # the ball does not leave at this phase

Start = tuple[float, float, float, float, float]

SHORT = 0.125  # flights shorter than this have their height computed as tau^2 times a series
ROUNDING = 32 * 2.2e-16  # bound on the relative rounding of a height


@compiled
def shape(tones: Floats, phi: float) -> tuple[float, float, float]:
    """``s(phi)``, ``s'(phi)`` and ``q(phi) = -s''(phi)``."""
    s = 0.0
    slope = 0.0
    q = 0.0
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        angle = n * phi + tones[j, 2]
        sine = tones[j, 1] * math.sin(angle)
        s += sine
        slope += tones[j, 1] * n * math.cos(angle)
        q += n * n * sine
    return s, slope, q


@compiled
def _remainders(x: float) -> tuple[float, float, float, float]:
    """``(1 - cos x)/x^2 - 1/2``, ``(x - sin x)/x^2``, ``sin x/x - 1`` and ``(1 - cos x)/x`` without cancellation."""
    y = x * x
    if y < 1.0:
        cosine = 0.0  # sum_{m >= 1} (-y)^m / (2 m + 2)!
        sine = 0.0  # sum_{m >= 1} (-y)^m / (2 m + 1)!
        for m in range(8, 0, -1):
            cosine = -y * (1.0 + cosine) / ((2 * m + 1) * (2 * m + 2))
            sine = -y * (1.0 + sine) / ((2 * m) * (2 * m + 1))
        cosine *= 0.5
        return cosine, -sine / x if x != 0.0 else 0.0, sine, x * (0.5 + cosine)
    sine_half = math.sin(0.5 * x)
    one_minus_cos = 2.0 * sine_half * sine_half
    sine = math.sin(x)
    return one_minus_cos / y - 0.5, (x - sine) / y, sine / x - 1.0, one_minus_cos / x


@compiled
def height_short(
    tones: Floats, gamma: float, phi0: float, a0: float, v0: float, tau: float
) -> tuple[float, float, float]:
    """``h, h', h''`` at a small ``tau`` with a small *relative* error; ``a0`` is h'' at take-off (0 at a threshold)."""
    g = 0.5 * a0
    g_slope = a0
    a = a0
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        angle = n * phi0 + tones[j, 2]
        weight = gamma * tones[j, 1] * n * n
        sine = weight * math.sin(angle)
        cosine = weight * math.cos(angle)
        x = n * tau
        cos_part, sin_part, sinc_part, vers_part = _remainders(x)
        g += sine * cos_part + cosine * sin_part
        g_slope += sine * sinc_part + cosine * vers_part
        a += x * (cosine * (1.0 + sinc_part) - sine * vers_part)
    return tau * (v0 + tau * g), v0 + tau * g_slope, a


@compiled
def height(tones: Floats, gamma: float, start: Start, phi: float, tau: float) -> tuple[float, float, float]:
    """``h, h', h''`` at the folded phase ``phi``, ``tau`` after the take-off ``start = (phi0, s0, s0', a0, v0)``."""
    phi0, s0, slope0, a0, v0 = start
    if tau < SHORT:
        return height_short(tones, gamma, phi0, a0, v0, tau)
    s, slope, q = shape(tones, phi)
    h = gamma * (s0 + slope0 * tau - s) + tau * (v0 - 0.5 * tau)
    return h, gamma * (slope0 - slope) + v0 - tau, gamma * q - 1.0


@compiled
def _rounding_of_height(tones: Floats, gamma: float, start: Start, tau: float) -> float:
    """Bound on the rounding error of `height` at ``tau``."""
    size = 0.0
    if tau < SHORT:
        for j in range(tones.shape[0]):
            size += abs(tones[j, 1]) * tones[j, 0] ** 2
        return ROUNDING * tau * (start[4] + tau * (1.0 + gamma * size))
    for j in range(tones.shape[0]):
        size += abs(tones[j, 1])
    return ROUNDING * (gamma * (size + abs(start[2]) * tau) + tau * (start[4] + tau))


@compiled
def _root_in_concave(
    tones: Floats, gamma: float, start: Start, turns: float, lo: float, hi: float
) -> tuple[float, float]:
    """The one root in ``(lo, hi]`` of a concave branch with ``h(lo) >= 0 >= h(hi)``: Halley inside a bracket."""
    left = lo
    x = hi
    h1 = 0.0
    for _ in range(100):
        tau = x - start[0] + turns
        h, h1, h2 = height(tones, gamma, start, x, tau)
        if h > 0.0:
            left = x
        else:
            hi = x
        determinant = 2.0 * h1 * h1 - h * h2
        new = x - 2.0 * h * h1 / determinant if determinant > h1 * h1 else x - h / h1
        if not left < new < hi:
            new = 0.5 * (left + hi)
        if abs(new - x) <= 2e-16 * (abs(x) if tau > SHORT else tau):
            return new, -h1
        x = new
    return x, -h1


@compiled
def _root_in_convex(
    tones: Floats, gamma: float, start: Start, turns: float, lo: float, hi: float
) -> tuple[bool, float, float, int]:
    """First root in ``(lo, hi]`` of a convex branch entered with ``h > 0 > h'``: ``(found, phase, -h', flag)``.

    Newton from the left climbs to the first root without passing it; where ``h' >= 0`` comes first there is none. A
    minimum nearer to zero than the rounding of h is flagged: double precision cannot decide it.
    """
    x = lo
    flag = 0
    for _ in range(200):
        tau = x - start[0] + turns
        h, h1, h2 = height(tones, gamma, start, x, tau)
        if abs(h - 0.5 * h1 * h1 / h2) < _rounding_of_height(tones, gamma, start, tau):
            flag = UNDECIDED
        if h1 >= 0.0:
            return False, x, 0.0, flag
        if h <= 0.0:
            return True, x, -h1, flag
        step = -h / h1
        if step <= 2e-16 * (abs(x) if tau > SHORT else tau):
            return True, x, -h1, flag
        x += step
        if x > hi:
            return False, x, 0.0, flag
    return True, x, -h1, UNDECIDED


@compiled
def land(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, phi0: float, a0: float, v0: float
) -> tuple[float, float, float, int]:
    """The first landing after the take-off at the folded phase ``phi0``.

    Parameters
    ----------
    tones, edge, n_windows
        A periodic forcing and its table (`model.branches.fill_edges`).
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
    start = (phi0, s0, slope0, a0, v0)
    if n_windows == 0:  # concave for ever: any point below the plate closes the bracket
        hi = phi0 + 1.0
        while height(tones, gamma, start, hi, hi - phi0)[0] > 0.0:
            hi = phi0 + 2.0 * (hi - phi0)
        x, speed = _root_in_concave(tones, gamma, start, 0.0, phi0, hi)
        return x - phi0, x, speed, 0
    i = branch_of(edge, n_windows, phi0)
    turns = 0.0
    lo = phi0
    fresh = True
    slope_lo = v0
    undecided = 0
    while True:
        hi = edge[i + 1]
        tau = hi - phi0 + turns
        h, h1, _ = height(tones, gamma, start, hi, tau)
        if i % 2 == 1:
            if h <= 0.0:
                x, speed = _root_in_concave(tones, gamma, start, turns, lo, hi)
                return x - phi0 + turns, x, speed, undecided
        elif fresh:
            if h <= 0.0:  # lifted less than rounding shows, at a window's end: three times what is left of it
                return 3.0 * tau, fold(phi0 + 3.0 * tau, edge[0]), 0.0, UNDECIDED
        elif slope_lo < 0.0:
            found, x, speed, flag = _root_in_convex(tones, gamma, start, turns, lo, hi)
            undecided |= flag
            if found:
                return x - phi0 + turns, x, speed, undecided
        fresh = False
        slope_lo = h1
        lo = hi
        i += 1
        if i == 2 * n_windows:
            i = 0
            lo = edge[0]
            turns += TWO_PI


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


@compiled
def orbit(
    tones: Floats,
    gamma: float,
    edge: Floats,
    n_windows: int,
    phi_rest: float,
    n_transient: int,
    taus: Floats,
    phases: Floats,
    flags: Flags,
) -> float:
    """Fly ``n_transient`` flights from rest at ``phi_rest``, then keep as many as ``taus`` holds.

    Fills ``taus``, ``phases`` (take-off, folded) and ``flags``; returns the last landing phase, folded, from which the
    orbit can be continued. No window (``n_windows == 0``): everything is filled with RESTS and zero flights.
    """
    if n_windows == 0:
        taus[:] = 0.0
        phases[:] = phi_rest
        flags[:] = RESTS
        return phi_rest
    landing = fold(phi_rest, edge[0])
    for k in range(-n_transient, taus.shape[0]):
        phi0, a0, _, reset = next_take_off(tones, gamma, edge, n_windows, landing)
        tau, landing, _, flag = land(tones, gamma, edge, n_windows, phi0, a0, 0.0)
        if k >= 0:
            taus[k] = tau
            phases[k] = phi0
            flags[k] = flag | (RESET if reset else 0)
    return landing


@compiled
def diagram(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    phi_rest: float,
    n_transient: int,
    taus: Floats,
    phases: Floats,
    flags: Flags,
) -> None:
    """`orbit` for each gamma into the rows of ``taus``, ``phases`` (in [0, 2 pi)) and ``flags``."""
    edge = np.empty(turning.shape[0] + 2)
    for row in range(gammas.shape[0]):
        n_windows = fill_edges(tones, turning, gammas[row], edge)
        orbit(tones, gammas[row], edge, n_windows, phi_rest, n_transient, taus[row], phases[row], flags[row])
        for k in range(taus.shape[1]):
            phases[row, k] = fold(phases[row, k], 0.0)
