"""The state of orbits flown side by side, one a lane: named rows of arrays, how an orbit is begun, and its take-offs.

An orbit's parameters and motion are numbers (``work``; after them, with friction, the branches of its rises and falls
and the edges of its falls), its bookkeeping whole numbers (``whole``); its flights are stored in ``flights`` and
``marks`` (a row, a lane, a flight). Rows are named as in ``work[GAMMA, lane]``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kernels.arrays import Floats, Integers
from kernels.lanes import WIDTH, load
from model.flight.bounces import short_bounce, surely_long
from model.flight.branches import TWO_PI
from model.flight.friction import rebound_or_rest
from model.flight.lanes.edge_table import TABLE, fold_onto
from model.flight.lanes.friction_lanes import BRANCH_ROWS, EDGE_ROWS
from model.flight.numerics import EdgeTables, FrictionRestitution, Number, compiled, inlined
from model.flight.segment import shape
from model.orbits.cycles import CHATTERS

# rows of ``work``: parameters; places of the tables going up and down, and their edges
GAMMA, MU_UP, MU_DOWN, E0, E1, UP, UP_LAST, DOWN, DOWN_LAST = range(9)
# the segment under way; its end; the flight so far; the state in which the ball was left
PHI, V0, H0, MOTION, AT_EDGE, TAU, X, H, V, PLAIN, TOTAL, SEGMENTS, BRANCH, LAST_PHI, LAST_V = range(9, 24)
# the plate's s, s' and q where the segment begins, and where it ends
S, SLOPE, Q, S_X, SLOPE_X, Q_X = range(24, 30)
NUMBERS = 30
# values of MOTION: a landing is first known to come, then located
RESTS, RISES, FALLS, HANGS, LANDS, LANDED = (float(k) for k in range(6))
# rows of a branch, from NUMBERS on: `model.flight.lanes.friction_lanes.Branch`
LO, HI, SEEN_LO, SEEN_HI, PER_GAIN, BEND_LO, BEND_HI = range(BRANCH_ROWS)
# rows of ``whole``; from SEEN on the flight that left each threshold, then its turn
ROW, COUNT, LIMIT, TURN, STATUS, FIRST, PERIODS, SEEN = range(8)
FLIES, CLOSED, FULL, STUCK, IDLE = range(5)  # values of STATUS
TAUS, PHASES, SPEEDS = range(3)  # of ``flights``
THRESHOLDS, MARKS = range(2)  # of ``marks``


class Lanes(NamedTuple):
    """Storage of orbits side by side; ``both`` holds the tables going up, a lane after the other, then down."""

    both: Floats
    work: Floats
    whole: Integers
    flights: Floats
    marks: Integers


def room_for_lanes(edges: int, most: int) -> Lanes:
    """Room for tables of ``edges`` and ``most`` flights of each orbit; nothing flies yet."""
    windows = (edges - 1) // 2
    rows = NUMBERS + 2 * BRANCH_ROWS * windows + EDGE_ROWS * (2 * windows + 1)
    whole = np.zeros((SEEN + 2 * edges, WIDTH), dtype=np.int64)
    whole[STATUS] = IDLE
    return Lanes(
        np.zeros(2 * WIDTH * TABLE * edges),
        np.zeros((rows, WIDTH)),
        whole,
        np.zeros((3, WIDTH, most)),
        np.zeros((2, WIDTH, most), dtype=np.int64),
    )


@inlined
def numbers(flat: Floats, name: int) -> Number:
    """A row of the flattened ``work``, all lanes."""
    return load(flat, name * WIDTH)


@inlined
def places_of_branches(work: Floats) -> tuple[int, int, int, int]:
    """Windows that there is room for; the first rows of the branches of rises, of those of falls, and of the edges."""
    windows = (work.shape[0] - NUMBERS - EDGE_ROWS) // (2 * BRANCH_ROWS + 2 * EDGE_ROWS)
    falls = NUMBERS + BRANCH_ROWS * windows
    return windows, NUMBERS, falls, falls + BRANCH_ROWS * windows


@inlined
def _keep_branch(both: Floats, work: Floats, lane: int, row: int, ends: tuple[int, int, float], level: float) -> None:
    """Fill the rows of a branch, from the places of its ends in ``both`` and the turn between the first and it."""
    lo, hi, turn = ends
    gamma, start, stop = work[GAMMA, lane], both[lo] - turn, both[hi]
    seen_lo, seen_hi = gamma * both[lo + 2] + level * start, gamma * both[hi + 2] + level * stop
    per_gain = 1.0 / (seen_hi - seen_lo)
    bend = 0.5 * (stop - start) ** 2 * gamma * per_gain
    work[row + LO, lane], work[row + HI, lane] = start, stop
    work[row + SEEN_LO, lane], work[row + SEEN_HI, lane] = seen_lo, seen_hi
    work[row + PER_GAIN, lane] = per_gain
    work[row + BEND_LO, lane], work[row + BEND_HI, lane] = -bend * both[lo + 3], bend * both[hi + 3]


@compiled
def keep_branches(both: Floats, work: Floats, lane: int) -> None:
    """Fill a lane's rows after `NUMBERS` from its tables; what is left over is out of reach."""
    windows, rises, falls, edges = places_of_branches(work)
    up, n_up = int(work[UP, lane]), int(work[UP_LAST, lane]) // 2
    down, n_down = int(work[DOWN, lane]), int(work[DOWN_LAST, lane]) // 2
    for w in range(windows):
        row = rises + BRANCH_ROWS * w
        if w < n_up:  # from the end of the window before to the start of this
            before = TABLE * (2 * (w if w > 0 else n_up) - 1)
            ends = up + before, up + TABLE * 2 * w, 0.0 if w > 0 else TWO_PI
            _keep_branch(both, work, lane, row, ends, 1.0 + work[MU_UP, lane])
        else:
            work[row + HI, lane], work[row + SEEN_HI, lane] = math.inf, -math.inf
        row = falls + BRANCH_ROWS * w
        if w < n_down:
            ends = down + TABLE * 2 * w, down + TABLE * (2 * w + 1), 0.0
            _keep_branch(both, work, lane, row, ends, 1.0 - work[MU_DOWN, lane])
        else:
            work[row + HI, lane], work[row + SEEN_HI, lane] = math.inf, math.inf
    for k in range(-1, 2 * windows):
        row, at = edges + EDGE_ROWS * (k + 1), down + TABLE * (k if k >= 0 else 2 * n_down - 1)
        for j in range(EDGE_ROWS):
            work[row + j, lane] = both[at + j] if n_down > 0 and k < 2 * n_down else math.inf
        if k < 0:
            work[row, lane] -= TWO_PI


@inlined
def law_of_lane(work: Floats, lane: int) -> FrictionRestitution:
    """Friction and restitution of a lane."""
    return FrictionRestitution(work[MU_UP, lane], work[MU_DOWN, lane], work[E0, lane], work[E1, lane])


@compiled
def tables_of_lane(both: Floats, work: Floats, lane: int) -> EdgeTables:
    """The edges of a lane's tables, for the kernels of one flight."""
    up, up_last = int(work[UP, lane]), int(work[UP_LAST, lane])
    down, down_last = int(work[DOWN, lane]), int(work[DOWN_LAST, lane])
    return EdgeTables(
        both[up : up + TABLE * (up_last + 1) : TABLE].copy(), up_last // 2,
        both[down : down + TABLE * (down_last + 1) : TABLE].copy(), down_last // 2,
    )  # fmt: skip


@inlined
def _wait(lanes: Lanes, closes: bool, lane: int, branch: int) -> int:
    """The window at whose threshold a ball at rest in ``branch`` leaves; -1 where that closes the orbit."""
    work, whole = lanes.work, lanes.whole
    n_up = int(work[UP_LAST, lane]) // 2
    window = ((branch + 1) // 2) % n_up
    # after the last window of a period the ball waits for the first of the next
    if branch == 2 * n_up - 1:
        whole[TURN, lane] += 1
    if closes and whole[SEEN + window, lane] >= 0:
        whole[FIRST, lane] = whole[SEEN + window, lane]
        whole[PERIODS, lane] = whole[TURN, lane] - whole[SEEN + n_up + window, lane]
        whole[STATUS, lane] = CLOSED
        return -1
    whole[SEEN + window, lane], whole[SEEN + n_up + window, lane] = whole[COUNT, lane], whole[TURN, lane]
    return window


@inlined
def keep_landing(
    tones: Floats, lanes: Lanes, lane: int, tau: float, phi: float, speed: float, bounces: bool
) -> tuple[float, float]:
    """Keep a landing; phase and speed after the rebound, or where its chatter has ended."""
    both, work, whole, flights, marks = lanes
    k, base, v = whole[COUNT, lane], work[UP, lane], 0.0
    flights[TAUS, lane, k], flights[SPEEDS, lane, k], marks[MARKS, lane, k] = tau, speed, 0
    if bounces:
        phi = fold_onto(both, base, phi)
    turns = flights[PHASES, lane, k] + tau - phi
    if bounces:
        v, tail = rebound_or_rest(tones, work[GAMMA, lane], law_of_lane(work, lane), phi, speed)
        if tail > 0.0:
            marks[MARKS, lane, k] = CHATTERS
            turns += phi + tail
            phi = fold_onto(both, base, phi + tail)
            turns -= phi
            work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane] = shape(tones, phi)
    whole[TURN, lane] += round(turns / TWO_PI)
    whole[COUNT, lane] = k + 1
    return phi, v


def leave_of(*, bounces: bool) -> Callable[..., None]:
    """The kernel that takes a ball off the plate; of one that never ``bounces`` the compiler leaves out the rest."""

    # a call would cost the ideal ball a third of its flight
    @(compiled if bounces else inlined)
    def leave(tones: Floats, lanes: Lanes, closes: bool, lane: int) -> None:
        """From the plate, at LAST_PHI and LAST_V, to the next flight that is not a short bounce; sets the STATUS."""
        both, work, whole, flights, marks = lanes
        phi, v = work[LAST_PHI, lane], work[LAST_V, lane] if bounces else 0.0
        base, last = int(work[UP, lane]), int(work[UP_LAST, lane])
        gamma, law = work[GAMMA, lane], law_of_lane(work, lane)
        known = True  # the plate's motion at phi
        work[MOTION, lane] = RESTS
        while True:
            k = whole[COUNT, lane]
            if k == whole[LIMIT, lane]:
                if not known:
                    work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane] = shape(tones, phi)
                work[LAST_PHI, lane], work[LAST_V, lane] = phi, v
                whole[STATUS, lane] = FULL
                return
            phi0, window, branch = phi, -1, 0
            if v <= 0.0:
                while branch + 1 < last and phi >= both[base + TABLE * (branch + 1)]:
                    branch += 1
                if branch % 2 == 1 or phi <= both[base + TABLE * branch]:
                    window = _wait(lanes, closes, lane, branch)
                    if window < 0:
                        return
                    branch = 2 * window
                    phi0 = both[base + TABLE * branch]
            flights[PHASES, lane, k], marks[THRESHOLDS, lane, k] = phi0, window
            if bounces and v > 0.0 and not (known and surely_long(tones, law, gamma * work[Q_X, lane], v)):
                short, tau, speed = short_bounce(tones, gamma, law, phi0, v)
                if short:
                    phi, v = keep_landing(tones, lanes, lane, tau, phi0 + tau, speed, bounces)
                    known = False
                    continue
            if window >= 0:
                at = base + TABLE * branch
                work[S, lane], work[SLOPE, lane] = both[at + 1], both[at + 2]
            elif known:
                work[S, lane], work[SLOPE, lane], work[Q, lane] = work[S_X, lane], work[SLOPE_X, lane], work[Q_X, lane]
            else:
                work[S, lane], work[SLOPE, lane], work[Q, lane] = shape(tones, phi)
            work[PHI, lane], work[BRANCH, lane], work[AT_EDGE, lane] = phi0, branch, 1.0 if window >= 0 else 0.0
            if bounces:
                work[V0, lane], work[H0, lane], work[MOTION, lane] = v, 0.0, RISES
                work[TOTAL, lane], work[SEGMENTS, lane] = 0.0, 0.0
            whole[STATUS, lane] = FLIES
            return

    return leave
