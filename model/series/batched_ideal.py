"""Many ideal orbits at once, one gamma a lane: every flight is flown, and the arithmetic runs as vector code.

The rule kept here: a landing is proven first exactly as in `model.flight.ideal.land`; what this file adds is order. For
all lanes together: (1) leave the plate, (2) walk the branches by their tabulated edges, without trigonometry, until one
is found whose ends enclose a single root, (3) a fixed number of Halley rounds. A lane whose proof or convergence is not
plain (a possible graze, a flight shorter than `SHORT_FLIGHT`, a slow root) is flown by `land`.
"""

from __future__ import annotations

import math

import numpy as np

from model.flight.branches import TWO_PI, fill_edges, fold, q_and_slope
from model.flight.ideal import RESET, RESTS, land
from model.flight.numerics import Flags, Floats, Rows, compiled, sincos
from model.flight.segment import shape

LANES = 64
ROUNDS = 4  # Halley: 0.3 -> 1e-2 -> 1e-6 -> 1e-18; the last round only confirms
SHORT_FLIGHT = 0.25
PLAIN_GRAZE = 1e-9  # heights nearer to the plate than this are left to `land`
CLEAR, TOUCHES, UNPLAIN = 0, 1, 2

Point = tuple[float, float, float]  # phase, height, slope

Out = tuple[Floats, Floats, Flags]

# rows of the lanes' whole numbers, and of their working array
COUNT, ROW, WINDOWS, BRANCH, WAITED, PLAIN, TAKEN = range(7)
PHI0, S0, SLOPE0, LO, HI, TURNS, X, SINE, COSINE, Q, LAST, CLEAR_FROM, CLEAR_TO, H_LO, H_HI, TANGENT = range(16)


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
def _start(gammas: Floats, highest: float, work: Floats, n: int) -> None:
    """Take what `_shapes` found at take-off, and the times between which no turn can hold a landing."""
    s0, slope0, clear_from, clear_to = work[S0], work[SLOPE0], work[CLEAR_FROM], work[CLEAR_TO]
    s0[:n] = work[SINE, :n]
    slope0[:n] = work[COSINE, :n]
    for lane in range(n):
        v = gammas[lane] * slope0[lane]
        discriminant = v * v + 2.0 * gammas[lane] * (s0[lane] - highest)
        root = math.sqrt(max(discriminant, 0.0))
        clear_from[lane] = v - root
        clear_to[lane] = v + root - TWO_PI


@compiled
def _guess(work: Floats, n: int) -> None:
    """Begin between the chord's root and the tangent's, which enclose the landing."""
    lo, hi, x, h_lo, h_hi, tangent = work[LO], work[HI], work[X], work[H_LO], work[H_HI], work[TANGENT]
    for lane in range(n):
        chord = lo[lane] + (hi[lane] - lo[lane]) * h_lo[lane] / (h_lo[lane] - h_hi[lane])
        x[lane] = 0.5 * (chord + tangent[lane])


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
def _dip(
    tones: Floats,
    gamma: float,
    take_off: tuple[float, float, float],
    turns: float,
    lo: Point,
    hi: Point,
) -> tuple[int, Point, Point]:
    """Whether a convex branch that falls and rises again touches the plate: ``(verdict, lo, hi)``.

    The tangents at both lie below the branch: where they meet above the
    plate it is CLEAR; a point found below encloses the first root, and only that one, with ``lo``: it TOUCHES.
    """
    phi0, s0, slope0 = take_off
    for _ in range(8):
        x = lo[0] + (hi[1] - lo[1] - hi[2] * (hi[0] - lo[0])) / (lo[2] - hi[2])
        if lo[1] + lo[2] * (x - lo[0]) > PLAIN_GRAZE:
            return CLEAR, lo, hi
        s, slope, _ = shape(tones, x)
        tau = x - phi0 + turns
        h = gamma * (s0 + slope0 * tau - s) - 0.5 * tau * tau
        h1 = gamma * (slope0 - slope) - tau
        if h < -PLAIN_GRAZE:
            return TOUCHES, lo, (x, h, h1)
        if h1 < 0.0:
            lo = (x, h, h1)
        else:
            hi = (x, h, h1)
    return UNPLAIN, lo, hi


@compiled
def _bracket(tones: Floats, gamma: float, tables: Floats, whole: Rows, work: Floats, lane: int) -> bool:
    """Walk the branches of a lane's flight to the first that holds its landing; False where the proof is not plain.

    Writes LO, HI, TURNS and, for `_guess`, the heights at both ends and the root of the tangent that cannot pass it.
    """
    phi0, s0, slope0 = work[PHI0, lane], work[S0, lane], work[SLOPE0, lane]
    clear_from, clear_to = work[CLEAR_FROM, lane], work[CLEAR_TO, lane]
    n_windows = whole[WINDOWS, lane]
    i = whole[BRANCH, lane] + 1
    turns = 0.0
    tau = tables[0, lane, i] - phi0
    h = gamma * (s0 + slope0 * tau - tables[1, lane, i]) - 0.5 * tau * tau
    h1 = gamma * (slope0 - tables[2, lane, i]) - tau
    if h <= 0.0:
        return False
    while True:
        hi_tau = tables[0, lane, i + 1] - phi0 + turns
        h_hi = gamma * (s0 + slope0 * hi_tau - tables[1, lane, i + 1]) - 0.5 * hi_tau * hi_tau
        h1_hi = gamma * (slope0 - tables[2, lane, i + 1]) - hi_tau
        if h_hi <= 0.0:
            work[LO, lane], work[HI, lane], work[TURNS, lane] = tables[0, lane, i], tables[0, lane, i + 1], turns
            work[H_LO, lane], work[H_HI, lane] = h, h_hi
            work[TANGENT, lane] = tables[0, lane, i + 1] - h_hi / h1_hi if i % 2 == 1 else tables[0, lane, i] - h / h1
            return True
        if i % 2 == 0 and h1 < 0.0 < h1_hi:
            lo, hi = (tables[0, lane, i], h, h1), (tables[0, lane, i + 1], h_hi, h1_hi)
            verdict, lo, hi = _dip(tones, gamma, (phi0, s0, slope0), turns, lo, hi)
            if verdict != CLEAR:
                work[LO, lane], work[HI, lane], work[TURNS, lane] = lo[0], hi[0], turns
                work[H_LO, lane], work[H_HI, lane], work[TANGENT, lane] = lo[1], hi[1], lo[0] - lo[1] / lo[2]
                return verdict == TOUCHES
        i += 1
        tau, h, h1 = hi_tau, h_hi, h1_hi
        if i == 2 * n_windows:
            i = 0
            turns += TWO_PI
        if clear_from < tau < clear_to:
            skipped = TWO_PI * math.floor((clear_to - tau) * (1.0 / TWO_PI) + 1.0)
            turns += skipped
            tau += skipped
            h = gamma * (s0 + slope0 * tau - tables[1, lane, i]) - 0.5 * tau * tau
            h1 -= skipped


@compiled
def _leave(tables: Floats, lane: int, n_windows: int, landing: float) -> tuple[float, int, bool]:
    """Where a ball on the plate at the folded phase ``landing`` leaves: phase, branch, whether it waited."""
    i = 0
    while i + 1 < 2 * n_windows and landing >= tables[0, lane, i + 1]:
        i += 1
    if i % 2 == 0 and landing > tables[0, lane, i]:
        return landing, i, False
    i = i + i % 2
    if i == 2 * n_windows:
        i = 0
    return tables[0, lane, i], i, True


@compiled
def _take_row(
    tones: Floats, turning: Floats, gammas: Floats, phi_rest: float, tables: Floats, whole: Rows, seen: Rows,
    landing: Floats, out: Out, lane: int,
) -> bool:  # fmt: skip
    """Give a lane the next gamma that lifts the ball: its edges in ``tables[0]``, ``s`` and ``s'`` there in 1 and 2."""
    while whole[TAKEN, 0] < gammas.shape[0]:
        row = whole[TAKEN, 0]
        whole[TAKEN, 0] += 1
        n_windows = fill_edges(tones, turning, gammas[row], tables[0, lane])
        if n_windows == 0:
            out[0][row], out[1][row], out[2][row] = 0.0, fold(phi_rest, 0.0), RESTS
            continue
        for i in range(2 * n_windows + 1):
            tables[1, lane, i], tables[2, lane, i], _ = shape(tones, tables[0, lane, i])
        whole[ROW, lane], whole[WINDOWS, lane], whole[COUNT, lane] = row, n_windows, 0
        landing[lane] = fold(phi_rest, tables[0, lane, 0])
        seen[lane] = -1
        return True
    return False


@compiled
def _finish(row: int, lane: int, count: int, period: int, orbit: Floats, bits: Flags, out: Out) -> None:
    """Copy the rest of a closed orbit, and keep what comes after the transient."""
    total = orbit.shape[2]
    first = total - out[0].shape[1]
    for k in range(count, total):
        orbit[0, lane, k], orbit[1, lane, k] = orbit[0, lane, k - period], orbit[1, lane, k - period]
        bits[lane, k] = bits[lane, k - period]
    out[0][row] = orbit[0, lane, first:]
    out[1][row] = orbit[1, lane, first:]
    out[2][row] = bits[lane, first:]


@compiled
def _leave_all(
    tones: Floats, turning: Floats, gammas: Floats, phi_rest: float, every_flight: bool, tables: Floats, whole: Rows,
    seen: Rows, work: Floats, landing: Floats, orbit: Floats, bits: Flags, out: Out,
) -> int:  # fmt: skip
    """Let every lane's ball leave the plate; a lane that is done takes the next row. Returns the busy lanes."""
    total = orbit.shape[2]
    busy = 0
    for lane in range(LANES):
        while True:
            if whole[COUNT, lane] >= total and not _take_row(
                tones, turning, gammas, phi_rest, tables, whole, seen, landing, out, lane
            ):
                break
            phi0, branch, reset = _leave(tables, lane, whole[WINDOWS, lane], landing[lane])
            work[PHI0, lane], whole[BRANCH, lane], whole[WAITED, lane] = phi0, branch, reset
            first, count = seen[lane, branch], whole[COUNT, lane]
            if reset:
                seen[lane, branch] = count
            if every_flight or not reset or first < 0:
                busy += 1
                break
            _finish(whole[ROW, lane], lane, count, count - first, orbit, bits, out)
            whole[COUNT, lane] = total
    return busy


@compiled
def _bracket_all(tones: Floats, gamma: Floats, tables: Floats, whole: Rows, work: Floats, total: int) -> None:
    """`_bracket` for every busy lane."""
    for lane in range(LANES):
        if whole[COUNT, lane] < total:
            whole[PLAIN, lane] = _bracket(tones, gamma[lane], tables, whole, work, lane)


@compiled
def _land_all(
    tones: Floats, gamma: Floats, tables: Floats, whole: Rows, work: Floats, landing: Floats, orbit: Floats,
    bits: Flags, out: Out,
) -> None:  # fmt: skip
    """Take the landings from the rounds, or fly them alone where they are not plain."""
    total = orbit.shape[2]
    for lane in range(LANES):
        k, reset = whole[COUNT, lane], whole[WAITED, lane]
        if k >= total:
            continue
        phi0 = work[PHI0, lane]
        tau = work[X, lane] - phi0 + work[TURNS, lane]
        landing[lane] = work[X, lane]
        flag = RESET if reset else 0
        if not whole[PLAIN, lane] or tau < SHORT_FLIGHT or not work[LAST, lane] <= 1e-6:
            a0 = 0.0 if reset else max(gamma[lane] * q_and_slope(tones, phi0)[0] - 1.0, 0.0)
            tau, landing[lane], _, graze = land(
                tones, gamma[lane], tables[0, lane], whole[WINDOWS, lane], phi0, a0, 0.0
            )
            flag |= graze
        orbit[0, lane, k], orbit[1, lane, k] = tau, phi0 - TWO_PI if phi0 >= TWO_PI else phi0
        bits[lane, k] = flag
        whole[COUNT, lane] = k + 1
        if k + 1 == total:
            _finish(whole[ROW, lane], lane, total, 0, orbit, bits, out)


@compiled
def lockstep_diagram(
    tones: Floats,
    turning: Floats,
    gammas: Floats,
    phi_rest: float,
    n_transient: int,
    every_flight: bool,
    out: Out,
) -> int:
    """Fly ``n_transient`` flights from rest at ``phi_rest`` at each gamma, then as many as the rows of ``out`` hold.

    Fills ``out``: flight times, take-off phases (in [0, 2 pi)) and flags, each ``(len(gammas), n_keep)``; returns the
    number of flights flown. Below take-off the flights are zero and flagged RESTS. Unless ``every_flight``, an orbit
    that leaves a threshold for the second time is closed, and the rest of it copied: it is equal to the last bit.
    """
    n, size, total = LANES, turning.shape[0] + 2, n_transient + out[0].shape[1]
    tables, work, orbit = np.zeros((3, n, size)), np.zeros((16, n)), np.zeros((2, n, total))
    gamma, landing, bits = np.ones(n), np.zeros(n), np.zeros((n, total), dtype=np.int8)
    whole, seen = np.zeros((7, n), dtype=np.int64), np.zeros((n, size), dtype=np.int64)
    whole[COUNT] = total
    highest = tones[:, 1].sum()
    flown = 0
    while total > 0:
        busy = _leave_all(
            tones, turning, gammas, phi_rest, every_flight, tables, whole, seen, work, landing, orbit, bits, out
        )
        if busy == 0:
            break
        flown += busy
        for lane in range(n):
            gamma[lane] = gammas[whole[ROW, lane]]
        _shapes(tones, work, PHI0, n)
        _start(gamma, highest, work, n)
        _bracket_all(tones, gamma, tables, whole, work, total)
        _guess(work, n)
        for _ in range(ROUNDS):
            _shapes(tones, work, X, n)
            _halley_round(gamma, work, n)
        _land_all(tones, gamma, tables, whole, work, landing, orbit, bits, out)
    return flown
