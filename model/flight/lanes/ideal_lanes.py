"""Ideal flights side by side: the first landings of `kernels.lanes.WIDTH` balls, each at a gamma of its own.

A landing is proven first as in `model.flight.ideal.land`; what is added is order. For all lanes together: walk the
branches by their tabulated edges, without trigonometry, to the first whose ends enclose the landing, then take a few
steps to the root (`model.flight.lanes.plate_lanes`). A lane whose proof or convergence is not plain (a near graze, a
short flight) is left to `land`.
"""

from __future__ import annotations

from typing import Any

from kernels.arrays import Floats
from kernels.lanes import any_of, floor, gather_rows, select, size, spread
from model.flight.branches import TWO_PI
from model.flight.lanes.edge_table import TABLE
from model.flight.lanes.plate_lanes import PLAIN_GRAZE, plate, root_in_branch, start_of_root
from model.flight.numerics import Number, inlined
from model.flight.segment import SHORT, clear_times


@inlined
def _step_on(far: Number, t: Number, wraps: Any, clear: Any, v: Number, end: Any) -> Any:
    """From the ``end`` (h, h') of a branch, at ``far`` and ``t`` after the start, on to the next branch.

    Whole turns during which the ball is surely above the plate (between the times ``clear``) are left out; where it
    ``wraps`` the table's period ends. Returns phase, h, h' of the next branch's start, and the turns to be added, in
    radians.
    """
    clear_from, clear_to = clear
    h, h1 = end
    skips = (t > clear_from) & (t < clear_to)
    skipped = select(skips, TWO_PI * floor((clear_to - t) * (1.0 / TWO_PI) + 1.0), 0.0)
    phase, turns = select(wraps, (far - TWO_PI, skipped + TWO_PI), (far, skipped))
    return phase, h + skipped * (v - (t + 0.5 * skipped)), h1 - skipped, turns


@inlined
def _height(gamma: Number, take_off: Any, x: Number, s: Number, slope: Number) -> tuple[Number, Number]:
    """``h`` and ``h'`` at ``x`` after a take-off from rest: its phase (less the turns since), s and s'."""
    phi0, s0, slope0 = take_off
    tau = x - phi0
    return gamma * (s0 + slope0 * tau - s) - 0.5 * tau * tau, gamma * (slope0 - slope) - tau


@inlined
def _dip(tones: Floats, gamma: Number, take_off: Any, unsure: Any, left: Any, right: Any) -> Any:
    """Whether a convex branch that falls and rises again touches the plate, in every ``unsure`` lane.

    ``left`` and ``right`` are points (phase, h, h') of the branch. The tangents at both lie below it: where they meet
    above the plate it is clear. A point found below encloses the first root, and only that one, with ``left``. Returns
    touches, undecided, left, right.
    """
    never = unsure & ~unsure
    touched, undecided = never, never
    dl, hl, sl = left
    dr, hr, sr = right
    for _ in range(8):
        y = dl + (hr - hl - sr * (dr - dl)) / (sl - sr)
        s, slope, _, _, _ = plate(tones, y)
        h, h1 = _height(gamma, take_off, y, s, slope)
        touches = unsure & (h < -PLAIN_GRAZE)
        near = unsure & (size(h) <= PLAIN_GRAZE)
        falls = unsure & ~touches & (h1 < 0.0)
        ends = unsure & (touches | (h1 >= 0.0))
        # the minimum lies between a falling and a rising point: the bracket closes on it
        dl, hl, sl = select(falls, (y, h, h1), (dl, hl, sl))
        dr, hr, sr = select(ends, (y, h, h1), (dr, hr, sr))
        touched, undecided = touched | touches, undecided | near
        meet = (hr - hl - sr * (dr - dl)) / (sl - sr)
        unsure = unsure & ~(touches | near) & (hl + sl * meet <= PLAIN_GRAZE)
        if not any_of(unsure):
            break
    return touched, undecided | unsure, (dl, hl, sl), (dr, hr, sr)


@inlined
def land_lanes(tones: Floats, highest: float, table: Floats, gamma: Any, place: Any, take_off: Any) -> Any:
    """First landings after take-offs in the windows of each lane: x, turns, speed, (s, s') there, plain.

    ``place`` holds the places of each lane's table and its last edge, and the branch of the take-off, a window;
    ``take_off`` phase, s and s' there.
    """
    (base, last, i), (phi0, s0, slope0) = place, take_off
    v = gamma * slope0
    clear_from, clear_to = clear_times(highest, gamma, s0, 0.0, v, 1.0)
    clear = clear_from, clear_to - TWO_PI
    i = i + 1.0
    edge, s, slope, _ = gather_rows(table, base + TABLE * i)
    tau = edge - phi0
    h = gamma * (s0 + slope0 * tau - s) - 0.5 * tau * tau
    h1 = gamma * (slope0 - slope) - tau
    plain = h > 0.0
    searching, turns = plain, spread(0.0)
    left, right, tangent, total = (edge, h, h1), (edge + 1.0, spread(-1.0), h1), edge, turns
    while any_of(searching):
        far, s, slope, _ = gather_rows(table, base + TABLE * (i + 1.0))
        t = far - phi0 + turns
        g = gamma * (s0 + slope0 * t - s) - 0.5 * t * t
        g1 = gamma * (slope0 - slope) - t
        width = far - edge
        concave = (i - 2.0 * floor(0.5 * i)) == 1.0  # odd
        found = searching & (g <= 0.0)
        tangent = select(found, select(concave, far - g / g1, edge - h / h1), tangent)
        left, right = select(found, (edge, h, h1), left), select(found, (far, g, g1), right)
        total = select(found, turns, total)
        # a convex branch lies above its end tangents: where these meet above the plate, it is clear
        meet = (g - h - g1 * width) / (h1 - g1)
        unsure = searching & ~concave & (h1 < 0.0) & (g1 > 0.0) & (g > 0.0) & (h + h1 * meet <= PLAIN_GRAZE)
        if any_of(unsure):
            touches, undecided, near, past = _dip(
                tones, gamma, (phi0 - turns, s0, slope0), unsure, (edge, h, h1), (far, g, g1)
            )
            found, plain = found | touches, plain & ~undecided
            tangent = select(touches, near[0] - near[1] / near[2], tangent)
            left, right = select(touches, near, left), select(touches, past, right)
            total = select(touches, turns, total)
        grazes = searching & ~plain
        searching = searching & ~(found | grazes)
        wraps = i + 1.0 >= last
        edge, h, h1, more = _step_on(far, t, wraps, clear, v, (g, g1))
        turns, i = turns + more, select(searching, select(wraps, 0.0, i + 1.0), i)
    lo, hi = left[0], right[0]
    chord = lo + (hi - lo) * left[1] / (left[1] - right[1])
    x = start_of_root((*left, 0.0), (*right, 0.0), 0.5 * (chord + tangent))
    begun = (phi0 - total, s0, slope0, 0.0, 0.0, 1.0)
    x, (_, v, s, slope, _), away = root_in_branch(tones, gamma, begun, (lo, hi), x, False, plain)
    plain = plain & ~away & (x - phi0 + total >= SHORT) & (v < 0.0)
    return x, total, -v, (s, slope), plain
