"""The state of orbits flown side by side, one a lane: named rows of arrays, and how an orbit is begun.

An orbit's parameters and motion are numbers (``work``; after them, with friction, the branches of its rises and falls
and the edges of its falls), its bookkeeping whole numbers (``whole``); its flights are kept in ``flights`` and
``marks`` (a row, a lane, a flight).
"""

from __future__ import annotations

import math

from kernels.arrays import Floats, Integers
from kernels.lanes import WIDTH, load
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.friction_lanes import BRANCH_ROWS, EDGE_ROWS
from model.flight.numerics import Number, compiled, inlined
from model.flight.records import FrictionRestitution

# rows of ``work``: parameters; places of the tables going up and down, and their edges
GAMMA, MU_UP, MU_DOWN, E0, E1, UP, UP_LAST, DOWN, DOWN_LAST = range(9)
# the segment under way; its end; the flight so far; the state in which the ball was left
PHI, V0, H0, MOTION, AT_EDGE, TAU, X, H, V, PLAIN, TOTAL, SEGMENTS, BRANCH, LAST_PHI, LAST_V = range(9, 24)
# the plate's s, s' and q where the segment begins, and where it ends
S, SLOPE, Q, S_X, SLOPE_X, Q_X = range(24, 30)
NUMBERS = 30
# values of MOTION: a landing is first known to come, then located
RESTS, RISES, FALLS, HANGS, LANDS, LANDED = (float(k) for k in range(6))
# rows of a branch, from NUMBERS on: `model.flight.friction_lanes.Branch`
LO, HI, SEEN_LO, SEEN_HI, PER_GAIN, BEND_LO, BEND_HI = range(BRANCH_ROWS)
# rows of ``whole``; from SEEN on the flight that left each threshold, then its turn
ROW, COUNT, LIMIT, TURN, STATUS, FIRST, PERIODS, SEEN = range(8)
FLIES, CLOSED, FULL, STUCK, IDLE = range(5)  # values of STATUS
TAUS, PHASES, SPEEDS = range(3)  # of ``flights``
THRESHOLDS, MARKS = range(2)  # of ``marks``


@inlined
def numbers(flat: Floats, name: int) -> Number:
    """A row of the flattened ``work``, all lanes."""
    return load(flat, name * WIDTH)


@compiled
def branch_rows(size: int) -> int:
    """Rows of ``work`` after `NUMBERS` for tables of ``size`` edges."""
    windows = (size - 1) // 2
    return 2 * BRANCH_ROWS * windows + EDGE_ROWS * (2 * windows + 1)


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


@inlined
def reset_at(
    both: Floats, closes: bool, work: Floats, whole: Integers, lane: int, branch: int
) -> tuple[int, float, bool]:
    """A ball at rest in ``branch`` waits for the next threshold: its window and phase, and whether that closes."""
    n_up = int(work[UP_LAST, lane]) // 2
    window = ((branch + 1) // 2) % n_up
    if branch == 2 * n_up - 1:
        whole[TURN, lane] += 1
    if closes and whole[SEEN + window, lane] >= 0:
        whole[FIRST, lane] = whole[SEEN + window, lane]
        whole[PERIODS, lane] = whole[TURN, lane] - whole[SEEN + n_up + window, lane]
        whole[STATUS, lane] = CLOSED
        return window, 0.0, True
    whole[SEEN + window, lane], whole[SEEN + n_up + window, lane] = whole[COUNT, lane], whole[TURN, lane]
    return window, both[int(work[UP, lane]) + TABLE * 2 * window], False
