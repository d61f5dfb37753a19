"""Many ideal orbits at once, one gamma a lane: every flight is flown, and the arithmetic runs as vector code.

The rule kept here: a lane's landing is proven first exactly as in `model.ideal_kernel.land`; what this file adds is
order. For all lanes together: (1) leave the plate, (2) walk the branches by their tabulated edges, without
trigonometry, until one is found whose ends enclose a single root, (3) a fixed number of Halley rounds. A lane whose proof or
convergence is not plain (a possible graze, a flight shorter than `SHORT_FLIGHT`, a slow root) is flown by `land`.
"""

from __future__ import annotations

import math

import numpy as np

from model.branches import TWO_PI, branch_of, fill_edges, fold, q_and_slope
from model.compiled import Flags, Floats, Rows, compiled, sincos
from model.ideal_kernel import RESET, RESTS, land
from model.stage import shape

LANES = 64
ROUNDS = 4  # Halley: 0.3 -> 1e-2 -> 1e-6 -> 1e-18; the last round only confirms
SHORT_FLIGHT = 0.25
PLAIN_GRAZE = 1e-9  # a convex branch whose tangents meet higher than this above the plate holds no root

# rows of the lanes' working array
PHI0, S0, SLOPE0, LO, HI, TURNS, X, SINE, COSINE, Q, LAST = range(11)


@compiled
def _shapes(tones: Floats, work: Floats, at: int, n: int) -> None:
    """``s``, ``s'`` and ``q`` at the phases of row ``at`` into the rows SINE, COSINE and Q."""
    phase, s, slope, q = work[at], work[SINE], work[COSINE], work[Q]
    s[:n] = 0.0
    slope[:n] = 0.0
    q[:n] = 0.0
    for j in range(tones.shape[0]):
        harmonic, b, p = tones[j, 0], tones[j, 1], tones[j, 2]
        for lane in range(n):
            sine, cosine = sincos(harmonic * phase[lane] + p)
            s[lane] += b * sine
            slope[lane] += b * harmonic * cosine
            q[lane] += b * harmonic * harmonic * sine


@compiled
def _halley_round(gammas: Floats, work: Floats, n: int) -> None:
    """One Halley step of every lane, kept in its bracket; LAST is the step's size, inf where it cannot be trusted."""
    phi0, s0, slope0, lo, hi, turns = work[PHI0], work[S0], work[SLOPE0], work[LO], work[HI], work[TURNS]
    x, s, slope, q, last = work[X], work[SINE], work[COSINE], work[Q], work[LAST]
    for lane in range(n):
        gamma = gammas[lane]
        tau = x[lane] - phi0[lane] + turns[lane]
        h = gamma * (s0[lane] + slope0[lane] * tau - s[lane]) - 0.5 * tau * tau
        h1 = gamma * (slope0[lane] - slope[lane]) - tau
        h2 = gamma * q[lane] - 1.0
        step = 2.0 * h * h1 / (2.0 * h1 * h1 - h * h2)
        new = x[lane] - step
        inside = (new > lo[lane]) & (new <= hi[lane])
        gentle = abs(step * h2) <= 1e-6 * abs(h1)
        last[lane] = abs(step) if inside & gentle else np.inf
        x[lane] = min(max(new, lo[lane]), hi[lane])


@compiled
def _bracket(
    gamma: float, edge: Floats, edge_s: Floats, edge_slope: Floats, n_windows: int, work: Floats, lane: int
) -> bool:
    """Walk the branches of a lane's flight to the first that holds its landing; False where the proof is not plain.

    Writes LO, HI, TURNS and a first guess X: between the chord's root and the root of the tangent that cannot pass it.
    """
    phi0, s0, slope0 = work[PHI0, lane], work[S0, lane], work[SLOPE0, lane]
    v = gamma * slope0
    discriminant = v * v + 2.0 * gamma * (s0 - edge_s[-1])
    root = math.sqrt(max(discriminant, 0.0))
    i = branch_of(edge, n_windows, phi0) + 1
    turns = 0.0
    tau = edge[i] - phi0
    h = gamma * (s0 + slope0 * tau - edge_s[i]) - 0.5 * tau * tau
    h1 = gamma * (slope0 - edge_slope[i]) - tau
    if h <= 0.0:
        return False
    while True:
        hi_tau = edge[i + 1] - phi0 + turns
        h_hi = gamma * (s0 + slope0 * hi_tau - edge_s[i + 1]) - 0.5 * hi_tau * hi_tau
        h1_hi = gamma * (slope0 - edge_slope[i + 1]) - hi_tau
        width = hi_tau - tau
        if h_hi <= 0.0:
            work[LO, lane] = edge[i]
            work[HI, lane] = edge[i + 1]
            work[TURNS, lane] = turns
            chord = width * h / (h - h_hi)
            tangent = width - h_hi / h1_hi if i % 2 == 1 else -h / h1
            work[X, lane] = edge[i] + 0.5 * (chord + tangent)
            return True
        if i % 2 == 0 and h1 < 0.0 < h1_hi:
            meet = (h_hi - h - h1_hi * width) / (h1 - h1_hi)
            if h + h1 * meet <= PLAIN_GRAZE:
                return False
        i += 1
        tau, h, h1 = hi_tau, h_hi, h1_hi
        if i == 2 * n_windows:
            i = 0
            turns += TWO_PI
        if discriminant > 0.0 and v - root < tau < v + root - TWO_PI:
            skipped = TWO_PI * math.floor((v + root - tau) / TWO_PI)
            turns += skipped
            tau += skipped
            h = gamma * (s0 + slope0 * tau - edge_s[i]) - 0.5 * tau * tau
            h1 -= skipped


@compiled
def _leave(edge: Floats, n_windows: int, landing: float) -> tuple[float, bool]:
    """Take-off phase of a ball on the plate at the folded phase ``landing``, and whether it waited for a threshold."""
    i = branch_of(edge, n_windows, landing)
    if i % 2 == 0 and landing > edge[i]:
        return landing, False
    return edge[2 * (((i + 1) // 2) % n_windows)], True


@compiled
def _fill_tables(
    tones: Floats, turning: Floats, gammas: Floats, edges: Floats, edge_s: Floats, edge_slope: Floats, windows: Flags
) -> None:
    """Each lane's edges (`model.branches.fill_edges`) with ``s`` and ``s'`` there; the last column of s: a bound on s."""
    highest = 0.0
    for j in range(tones.shape[0]):
        highest += tones[j, 1]
    for lane in range(gammas.shape[0]):
        windows[lane] = fill_edges(tones, turning, gammas[lane], edges[lane])
        for i in range(2 * windows[lane] + 1):
            edge_s[lane, i], edge_slope[lane, i], _ = shape(tones, edges[lane, i])
        edge_s[lane, -1] = highest


@compiled
def _lanes(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    rows: Rows,
    phi_rest: float,
    n_transient: int,
    taus: Floats,
    phases: Floats,
    flags: Flags,
) -> None:
    """The given ``rows`` of `lockstep_diagram`: at most LANES, all above take-off."""
    n = gammas.shape[0]
    size = turning.shape[0] + 3
    edges, edge_s, edge_slope = np.empty((n, size)), np.empty((n, size)), np.empty((n, size))
    windows = np.empty(n, dtype=np.int8)
    _fill_tables(tones, turning, gammas, edges, edge_s, edge_slope, windows)
    work = np.zeros((11, n))
    landing = np.empty(n)
    reset = np.empty(n, dtype=np.bool_)
    plain = np.empty(n, dtype=np.bool_)
    for lane in range(n):
        landing[lane] = fold(phi_rest, edges[lane, 0])
    for k in range(-n_transient, taus.shape[1]):
        for lane in range(n):
            work[PHI0, lane], reset[lane] = _leave(edges[lane], windows[lane], landing[lane])
        _shapes(tones, work, PHI0, n)
        work[S0] = work[SINE]
        work[SLOPE0] = work[COSINE]
        for lane in range(n):
            plain[lane] = _bracket(
                gammas[lane], edges[lane], edge_s[lane], edge_slope[lane], windows[lane], work, lane
            )
        for _ in range(ROUNDS):
            _shapes(tones, work, X, n)
            _halley_round(gammas, work, n)
        for lane in range(n):
            phi0 = work[PHI0, lane]
            tau = work[X, lane] - phi0 + work[TURNS, lane]
            landing[lane] = work[X, lane]
            flag = 0
            if not plain[lane] or tau < SHORT_FLIGHT or not work[LAST, lane] <= 1e-6:
                a0 = 0.0 if reset[lane] else max(gammas[lane] * q_and_slope(tones, phi0)[0] - 1.0, 0.0)
                tau, landing[lane], _, flag = land(tones, gammas[lane], edges[lane], windows[lane], phi0, a0, 0.0)
            if k >= 0:
                taus[rows[lane], k] = tau
                phases[rows[lane], k] = fold(phi0, 0.0)
                flags[rows[lane], k] = flag | (RESET if reset[lane] else 0)


@compiled
def lockstep_diagram(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    phi_rest: float,
    n_transient: int,
    taus: Floats,
    phases: Floats,
    flags: Flags,
) -> None:
    """Fly ``n_transient`` flights from rest at ``phi_rest`` at each gamma, then as many as the rows of the arrays hold.

    Fills ``taus``, ``phases`` (take-off, in [0, 2 pi)) and ``flags``, each ``(len(gammas), n_keep)``. Below take-off
    the flights are zero and flagged RESTS.
    """
    spare = np.empty(turning.shape[0] + 2)
    flying = np.empty(gammas.shape[0], dtype=np.int64)
    n = 0
    for row in range(gammas.shape[0]):
        if fill_edges(tones, turning, gammas[row], spare) == 0:
            taus[row] = 0.0
            phases[row] = fold(phi_rest, 0.0)
            flags[row] = RESTS
        else:
            flying[n] = row
            n += 1
    for start in range(0, n, LANES):
        rows = flying[start : min(start + LANES, n)]
        _lanes(tones, turning, gammas[rows], rows, phi_rest, n_transient, taus, phases, flags)
