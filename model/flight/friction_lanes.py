"""Segments of flights with friction side by side: the end of a rise or a fall in each of `kernels.lanes.WIDTH` lanes.

The events are proven as in `model.flight.friction`: every lane walks the branches of its segment by tabulated edges to
the first that holds the end of the segment, a standstill or a landing, and a few Halley steps give all ends together. A
lane whose proof or convergence is not plain is left to `rise` and `fall`.
"""

from __future__ import annotations

from typing import Any

from kernels.lanes import any_of, floor, select
from kernels.rows import gather_rows
from model.flight.branch_walk import branch_after, odd, step_on
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.numerics import Floats, Number, inlined
from model.flight.plate_lanes import root_in_branch, start_of_root
from model.flight.records import Segment
from model.flight.segment import SHORT, clear_times, height

PLAIN_GRAZE = 1e-9  # heights nearer to the plate than this are left to `fall`
PLAIN_SPEED = 0.05  # impacts of falls shorter than `SHORT` and slower than this are left to its series
PLAIN_TIME = 0.01  # segments shorter than this are left to the series of `model.flight.segment`


@inlined
def _clear(bounds: Any, gamma: Number, segment: Segment, rising: Any) -> Any:
    """Times between which a fall neither ends nor can end, less a turn; whole turns that a rise surely lasts."""
    highest, fastest = bounds
    _, s0, slope0, _, v0, h0, level = segment
    v = gamma * slope0 + v0
    clear_from, clear_to = clear_times(highest, gamma, s0, h0, v, level)
    falling = (v + gamma * fastest) / level
    sure = (v - gamma * fastest) / level
    turns = select(rising & (sure > 0.0), TWO_PI * floor(sure * (1.0 / TWO_PI)), 0.0)
    return (select(clear_from > falling, clear_from, falling), select(rising, -1.0, clear_to - TWO_PI)), turns


@inlined
def end_of_segment(
    tones: Floats, bounds: Any, table: Floats, gamma: Number, place: Any, segment: Segment, rising: Any, flies: Any
) -> Any:
    """Where a rise ends at a standstill, or a fall at one or on the plate.

    Parameters
    ----------
    bounds
        Bounds of ``|s|`` and ``|s'|``.
    place
        Of each lane the place of its table in ``table``, the number of its edges and the branch in which it starts.
    segment
        Its start, s, s' and h'' there, and the pull.
    rising, flies
        Masks.

    Returns
    -------
    tau, phase, h, h', (s, s', q) at the phase, stops, plain
    """
    base, last, i = place
    phi0, s0, slope0, a0, v0, h0, level = segment
    v = gamma * slope0 + v0
    clear, turns = _clear(bounds, gamma, segment, rising)
    edge, h, h1, h2 = phi0, h0 + turns * (v - 0.5 * level * turns), v0 - level * turns, a0
    searching, plain = flies, flies
    left, right, total = (edge, h, h1, h2), (edge + 1.0, h, h1), turns
    guess = phi0
    stops = rising
    while any_of(searching):
        far, s, slope, _ = gather_rows(table, base + TABLE * (i + 1.0))
        t = far - phi0 + turns
        g, g1 = height(gamma, segment, s, slope, t)
        concave = odd(i)
        halts = searching & rising & concave & (g1 <= 0.0)
        lands = searching & ~rising & (g <= 0.0)
        turns_up = searching & ~rising & ~concave & (g > 0.0) & (g1 >= 0.0)
        odd_turn = turns_up & (h1 >= 0.0)
        plain = plain & ~odd_turn
        halts = halts | (turns_up & ~odd_turn)
        found = lands | halts
        left = (
            select(found, edge, left[0]), select(found, h, left[1]), select(found, h1, left[2]),
            select(found, h2, left[3]),
        )  # fmt: skip
        right = select(found, far, right[0]), select(found, g, right[1]), select(found, g1, right[2])
        total = select(found, turns, total)
        stops = (stops | halts) & ~lands
        searching = searching & ~(found | odd_turn)
        edge, h, h1, more = step_on(far, t, i, last, clear, v, level, (g, g1))
        h2 = 0.0 * h
        turns, i = turns + more, select(searching, branch_after(i, last), i)
    lo, hi = left[0], right[0]
    at_lo, at_hi = select(stops, left[2], left[1]), select(stops, right[2], right[1])
    guess = lo + (hi - lo) * at_lo / (at_lo - at_hi)
    x = start_of_root(left, (*right, 0.0), guess, stops)
    take_off = (phi0 - total, s0, slope0, v0, h0, level)
    x, h_end, v_end, s, slope, q, away = root_in_branch(tones, gamma, take_off, (lo, hi), x, stops, plain)
    tau = x - phi0 + total
    # the lowest point of a convex branch above the plate: no landing in it
    surely_lands = ~stops & (((v_end < 0.0) & (tau >= SHORT)) | (v_end < -PLAIN_SPEED))
    clear_of_plate = (stops & (h_end > PLAIN_GRAZE)) | surely_lands
    plain = plain & ~away & clear_of_plate & (tau >= PLAIN_TIME)
    return tau, x, h_end, v_end, (s, slope, q), stops, plain


@inlined
def hang_in_lanes(table: Floats, up: Any, down: Any, here: Any) -> Any:
    """`model.flight.friction.hang` in lanes: ``(rises, waiting time, branch, at a threshold, (phase, s, s'))``.

    ``up`` and ``down`` are the places of each lane's tables, their numbers of edges, and the phase and its branch in
    them; ``here`` is s and s' at that phase.
    """
    up_base, up_last, at_up, k = up
    down_base, down_last, at, i = down
    stays = (down_last > 0.0) & ~odd(i)
    inside = stays & (up_last > 0.0) & ~odd(k)
    hangs = stays & ~inside
    wait, branch, lifted = 0.0 * at, select(inside, k, i), inside
    phase, s, slope = select(inside, at_up, at), here[0], here[1]
    if any_of(hangs):
        until, s_down, slope_down, _ = gather_rows(table, down_base + TABLE * (i + 1.0))
        above, s_up, slope_up, _ = gather_rows(table, up_base + TABLE * (k + 1.0))
        rises = hangs & (up_last > 0.0) & (above - at_up < until - at)
        lifted = inside | rises
        wait = select(hangs, select(rises, above - at_up, until - at), wait)
        branch = select(hangs, select(rises, branch_after(k, up_last), i + 1.0), branch)
        folded = select(k + 1.0 >= up_last, above - TWO_PI, above)
        phase = select(hangs, select(rises, folded, until), phase)
        s = select(hangs, select(rises, s_up, s_down), s)
        slope = select(hangs, select(rises, slope_up, slope_down), slope)
    return lifted, wait, branch, hangs, (phase, s, slope)
