"""Choice of the branch that ends each segment, and the Halley iterations of all orbits together.

The rule kept here: a branch is chosen from tabulated edges alone, and only where its ends prove that it holds the end
of the stage and no earlier one does; any other lane is said not to be plain.
"""

from __future__ import annotations

import math

import numpy as np

from model.flight.branches import TWO_PI
from model.flight.numerics import Floats, Rows, compiled, sincos
from model.flight.segment import total_speed

PLAIN_GRAZE = 1e-9

# rows of the lanes' working array: the stage, its bracket, the shape at X, and what the last round found
PHI, V0, H0, LEVEL, S0, SLOPE0, LO, HI, TURNS, X, STOPS, S, SLOPE, Q, JERK, LAST, H, V = range(18)
# rows of the lanes' flights
TAKE_OFF, SPEED, TOTAL = range(3)
# rows of the lanes' whole numbers
COUNT, FLAG, RISING, RESETS, AT_EDGE, PLAIN, ROW, N_UP, N_DOWN = range(9)


@compiled
def shapes(tones: Floats, work: Floats, at: int, n: int) -> None:
    """``s``, ``s'``, ``q`` and ``q'`` at the phases of row ``at``."""
    phase, s, slope, q, jerk = work[at], work[S], work[SLOPE], work[Q], work[JERK]
    s[:n] = 0.0
    slope[:n] = 0.0
    q[:n] = 0.0
    jerk[:n] = 0.0
    for j in range(tones.shape[0]):
        harmonic, b, p = tones[j, 0], tones[j, 1], tones[j, 2]
        for lane in range(n):
            sine, cosine = sincos(harmonic * phase[lane] + p)
            sine *= b
            cosine *= b * harmonic
            s[lane] += sine
            slope[lane] += cosine
            q[lane] += harmonic * harmonic * sine
            jerk[lane] += harmonic * harmonic * cosine


@compiled
def halley_round(gammas: Floats, work: Floats, n: int) -> None:
    """One Halley step of every lane on h' (where STOPS) or on h, in its bracket; H and V are those after the step."""
    phi0, v0, h0, level, s0, slope0 = work[PHI], work[V0], work[H0], work[LEVEL], work[S0], work[SLOPE0]
    lo, hi, turns, x, stops = work[LO], work[HI], work[TURNS], work[X], work[STOPS]
    s, slope, q, jerk, last, h_out, v_out = work[S], work[SLOPE], work[Q], work[JERK], work[LAST], work[H], work[V]
    for lane in range(n):
        gamma = gammas[lane]
        tau = x[lane] - phi0[lane] + turns[lane]
        h = h0[lane] + gamma * (s0[lane] + slope0[lane] * tau - s[lane]) + tau * (v0[lane] - 0.5 * level[lane] * tau)
        v = v0[lane] + gamma * (slope0[lane] - slope[lane]) - level[lane] * tau
        a = gamma * q[lane] - level[lane]
        j = gamma * jerk[lane]
        stop = stops[lane] > 0.5
        f = v if stop else h
        f1 = a if stop else v
        f2 = j if stop else a
        step = 2.0 * f * f1 / (2.0 * f1 * f1 - f * f2)
        new = x[lane] - step
        inside = (new > lo[lane]) & (new <= hi[lane])
        gentle = abs(step * f2) <= 1e-6 * abs(f1)
        last[lane] = abs(step) if inside & gentle else np.inf
        x[lane] = min(max(new, lo[lane]), hi[lane])
        h_out[lane] = h - step * (v - 0.5 * step * a)
        v_out[lane] = v - step * (a - 0.5 * step * j)


@compiled
def _set_bracket(work: Floats, lane: int, lo: float, hi: float, turns: float, guess: float, stops: float) -> bool:
    """Write a lane's bracket and first guess; always plain."""
    work[LO, lane], work[HI, lane], work[TURNS, lane], work[X, lane] = lo, hi, turns, guess
    work[STOPS, lane] = stops
    return True


@compiled
def _bracket_rise(gamma: float, up: Floats, slopes: Floats, n_up: int, fastest: float, work: Floats, lane: int) -> bool:
    """The branch in which a rising lane first stands still; always plain."""
    phi0, v0, level, slope0 = work[PHI, lane], work[V0, lane], work[LEVEL, lane], work[SLOPE0, lane]
    i = 0
    while i + 1 < 2 * n_up and phi0 >= up[lane, i + 1]:
        i += 1
    turns = TWO_PI * math.floor(max((v0 + gamma * (slope0 - fastest)) / level, 0.0) * (1.0 / TWO_PI))
    lo = phi0
    v = v0 if turns == 0.0 else v0 + gamma * (slope0 - work[SLOPE0, lane]) - level * turns
    while True:
        hi = up[lane, i + 1]
        v_hi = v0 + gamma * (slope0 - slopes[lane, i + 1]) - level * (hi - phi0 + turns)
        if i % 2 == 1 and v_hi <= 0.0:
            return _set_bracket(work, lane, lo, hi, turns, lo + (hi - lo) * v / (v - v_hi), 1.0)
        v = v_hi
        i += 1
        if i == 2 * n_up:
            i = 0
            turns += TWO_PI
        lo = up[lane, i]


@compiled
def _bracket_fall(
    gamma: float,
    down: Floats,
    heights: Floats,
    slopes: Floats,
    n_down: int,
    bounds: tuple[float, float],
    work: Floats,
    lane: int,
) -> bool:
    """The branch in which a falling lane lands or stands still; False where the proof is not plain."""
    phi0, v0, h0, level = work[PHI, lane], work[V0, lane], work[H0, lane], work[LEVEL, lane]
    s0, slope0 = work[S0, lane], work[SLOPE0, lane]
    fastest, highest = bounds
    v_mean = gamma * slope0 + v0
    discriminant = v_mean * v_mean - 2.0 * level * (gamma * (highest - s0) - h0)
    root = math.sqrt(max(discriminant, 0.0))
    clear_from = max((v_mean - root) / level, (v_mean + gamma * fastest) / level)
    clear_to = (v_mean + root) / level - TWO_PI if discriminant > 0.0 else 0.0
    i = 0
    while i + 1 < 2 * n_down and phi0 >= down[lane, i + 1]:
        i += 1
    if i % 2 == 0:
        return False
    lo, h, v = phi0, h0, v0
    turns = 0.0
    while True:
        hi = down[lane, i + 1]
        tau = hi - phi0 + turns
        h_hi = h0 + gamma * (s0 + slope0 * tau - heights[lane, i + 1]) + tau * (v0 - 0.5 * level * tau)
        v_hi = v0 + gamma * (slope0 - slopes[lane, i + 1]) - level * tau
        if h_hi <= 0.0:
            chord = lo + (hi - lo) * h / (h - h_hi)
            tangent = hi - h_hi / v_hi if i % 2 == 1 else lo - h / v
            return _set_bracket(work, lane, lo, hi, turns, 0.5 * (chord + tangent), 0.0)
        if i % 2 == 0 and v_hi >= 0.0:
            meet = (h_hi - h - v_hi * (hi - lo)) / (v - v_hi)
            if h + v * meet <= PLAIN_GRAZE:
                return False
            return _set_bracket(work, lane, lo, hi, turns, lo + (hi - lo) * v / (v - v_hi), 1.0)
        lo, h, v = hi, h_hi, v_hi
        i += 1
        if i == 2 * n_down:
            i = 0
            turns += TWO_PI
            lo = down[lane, 0]
        if clear_from < tau < clear_to:
            skipped = TWO_PI * math.floor((clear_to - tau) * (1.0 / TWO_PI) + 1.0)
            turns += skipped
            tau += skipped
            h = h0 + gamma * (s0 + slope0 * tau - heights[lane, i]) + tau * (v0 - 0.5 * level * tau)
            v -= level * skipped


@compiled
def bracket(tones: Floats, gammas: Floats, up: Floats, down: Floats, whole: Rows, work: Floats, n: int) -> None:
    """Every lane's branch, rising or falling."""
    fastest, highest = total_speed(tones), tones[:, 1].sum()
    for lane in range(n):
        gamma = gammas[lane]
        if whole[RISING, lane]:
            whole[PLAIN, lane] = _bracket_rise(gamma, up[0], up[2], whole[N_UP, lane], fastest, work, lane)
        else:
            whole[PLAIN, lane] = _bracket_fall(
                gamma, down[0], down[1], down[2], whole[N_DOWN, lane], (fastest, highest), work, lane
            )
