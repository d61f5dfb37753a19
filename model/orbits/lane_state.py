"""The state of orbits flown side by side, one a lane: named rows of arrays, and how an orbit is begun.

An orbit's parameters and motion are numbers (``work``; after them the edges
of its tables, for comparisons), its bookkeeping whole numbers (``whole``); its flights are kept
in ``flights`` and ``marks`` (a row, a lane, a flight).
"""

from __future__ import annotations

import math

from kernels.lanes import WIDTH, floor, load, select, spread
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.numerics import Floats, Number, compiled, inlined
from model.flight.records import FrictionRestitution
from model.orbits.cycles import Integers

# rows of ``work``: parameters; places of the tables going up and down, and their edges
GAMMA, MU_UP, MU_DOWN, E0, E1, UP, UP_LAST, DOWN, DOWN_LAST = range(9)
# the segment under way; its end; the flight so far; the state in which the ball was left
PHI, V0, H0, RISING, AT_EDGE, TAU, X, H, V, STOPS, PLAIN, BRANCH, TOTAL, LAST_PHI, LAST_V = range(9, 24)
# the plate's s, s' and q where the segment begins, and where it ends
S, SLOPE, Q, S_X, SLOPE_X, Q_X = range(24, 30)
NUMBERS = 30
# rows of ``whole``; from SEEN on the flight that left each threshold, then its turn
ROW, COUNT, LIMIT, TURN, SEGMENTS, STATUS, FIRST, PERIODS, SEEN = range(9)
FLIES, CLOSED, FULL, STUCK, IDLE = range(5)  # values of STATUS
TAUS, PHASES, SPEEDS = range(3)  # of ``flights``
THRESHOLDS, MARKS = range(2)  # of ``marks``


@inlined
def numbers(flat: Floats, name: int) -> Number:
    """A row of the flattened ``work``, all lanes."""
    return load(flat, name * WIDTH)


@inlined
def edge_rows(work: Floats) -> tuple[int, int]:
    """Rows of ``work`` after `NUMBERS`, as many for the tables going up as down: a lane's edges below each other."""
    return NUMBERS, NUMBERS + (work.shape[0] - NUMBERS) // 2


@compiled
def copy_edges(both: Floats, work: Floats, lane: int) -> None:
    """Copy the edges of a lane's tables to their rows of ``work``; a row left over is out of reach."""
    up, down = edge_rows(work)
    for row in range(NUMBERS, work.shape[0]):
        rises = row < down
        k = row - (up if rises else down)
        base, last = work[UP if rises else DOWN, lane], work[UP_LAST if rises else DOWN_LAST, lane]
        work[row, lane] = both[int(base) + TABLE * k] if k == 0 or k < last else math.inf


@inlined
def place_on(flat: Floats, rows: tuple[int, int], phi: Number) -> tuple[Number, Number]:
    """``phi`` folded onto the period of the tables whose edges are in the ``rows`` (from, to), and its branch."""
    first = numbers(flat, rows[0])
    folded = phi - TWO_PI * floor((phi - first) * (1.0 / TWO_PI))
    folded = select(folded < first, folded + TWO_PI, folded)
    folded = select(folded >= first + TWO_PI, folded - TWO_PI, folded)
    branch = 0.0 * phi
    for row in range(rows[0] + 1, rows[1] - 2):
        branch = branch + select(folded >= numbers(flat, row), spread(1.0), spread(0.0))
    return folded, branch


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
