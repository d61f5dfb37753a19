"""Ideal flights side by side: the first landings of `kernels.lanes.WIDTH` balls, each at a gamma of its own.

A landing is proven first as in `model.flight.ideal.land`; what is added is order. For all lanes together: walk the
branches by their tabulated edges, without trigonometry, to the first whose ends enclose the landing, then take a few
Halley steps. A lane whose proof or convergence is not plain (a near graze, a short flight) is left to `land`.
"""

from __future__ import annotations

from typing import Any

from kernels.lanes import any_of, gather, select, size, spread
from model.flight.branch_walk import branch_after, odd, step_on
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.numerics import Floats, Number, inlined
from model.flight.segment import SHORT, clear_times, shape

PLAIN_GRAZE = 1e-9  # heights nearer to the plate than this are left to `land`
ROUNDS = 8  # of Halley at most; three or four are taken
CONVERGED = 1e-6  # a last step of Halley smaller than this leaves an error of its cube
DIPS = 8  # halvings of a dip, at most


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
    above the plate it is clear. A point found below encloses the first root, and only that one, with ``left``.

    Returns
    -------
    touches, undecided, left, right
    """
    never = unsure & ~unsure
    touched, undecided = never, never
    dl, hl, sl = left
    dr, hr, sr = right
    for _ in range(DIPS):
        y = dl + (hr - hl - sr * (dr - dl)) / (sl - sr)
        s, slope, _ = shape(tones, y)
        h, h1 = _height(gamma, take_off, y, s, slope)
        touches = unsure & (h < -PLAIN_GRAZE)
        near = unsure & (size(h) <= PLAIN_GRAZE)
        falls = unsure & ~touches & (h1 < 0.0)
        ends = unsure & (touches | (h1 >= 0.0))
        dl, hl, sl = select(falls, y, dl), select(falls, h, hl), select(falls, h1, sl)
        dr, hr, sr = select(ends, y, dr), select(ends, h, hr), select(ends, h1, sr)
        touched, undecided = touched | touches, undecided | near
        meet = (hr - hl - sr * (dr - dl)) / (sl - sr)
        unsure = unsure & ~(touches | near) & (hl + sl * meet <= PLAIN_GRAZE)
        if not any_of(unsure):
            break
    return touched, undecided | unsure, (dl, hl, sl), (dr, hr, sr)


@inlined
def _halley(tones: Floats, gamma: Number, take_off: Any, x: Number, lo: Number, hi: Number, away: Any) -> Any:
    """The one root of each bracket from ``x`` on, the impact speed there, and the lanes that have not converged."""
    speed = x
    for _ in range(ROUNDS):
        s, slope, q = shape(tones, x)
        h, h1 = _height(gamma, take_off, x, s, slope)
        h2 = gamma * q - 1.0
        step = 2.0 * h * h1 / (2.0 * h1 * h1 - h * h2)
        new = x - step
        inside = (new > lo) & (new <= hi)
        gentle = (size(step) <= CONVERGED) & (size(step * h2) <= CONVERGED * size(h1))
        speed = select(away, h2 * step - h1, speed)
        x = select(away, select(inside, new, select(new > hi, 0.5 * (x + hi), 0.5 * (x + lo))), x)
        away = away & ~(inside & gentle)
        if not any_of(away):
            break
    return x, speed, away


@inlined
def land_lanes(
    tones: Floats, highest: float, table: Floats, gamma: Any, base: Any, last: Any, k: Any, phi0: Any, s0: Any,
    slope0: Any,
) -> Any:  # fmt: skip
    """First landings after take-offs at ``phi0`` in the windows ``k`` of each lane.

    Returns
    -------
    x, turns, speed, plain
    """
    v = gamma * slope0
    clear_from, clear_to = clear_times(highest, gamma, s0, 0.0, v, 1.0)
    clear = clear_from, clear_to - TWO_PI
    i = k + 1.0
    at = base + TABLE * i
    edge = gather(table, at)
    tau = edge - phi0
    h = gamma * (s0 + slope0 * tau - gather(table, at + 1.0)) - 0.5 * tau * tau
    h1 = gamma * (slope0 - gather(table, at + 2.0)) - tau
    plain = h > 0.0
    searching = plain
    turns = spread(0.0)
    lo, hi, h_lo, h_hi, tangent, total = edge, edge + 1.0, h, spread(-1.0), edge, turns
    while any_of(searching):
        at = base + TABLE * i
        far = gather(table, at + 3.0)
        t = far - phi0 + turns
        g = gamma * (s0 + slope0 * t - gather(table, at + 4.0)) - 0.5 * t * t
        g1 = gamma * (slope0 - gather(table, at + 5.0)) - t
        width = far - edge
        concave = odd(i)
        found = searching & (g <= 0.0)
        tangent = select(found, select(concave, far - g / g1, edge - h / h1), tangent)
        lo, hi, total = select(found, edge, lo), select(found, far, hi), select(found, turns, total)
        h_lo, h_hi = select(found, h, h_lo), select(found, g, h_hi)
        meet = (g - h - g1 * width) / (h1 - g1)
        unsure = searching & ~concave & (h1 < 0.0) & (g1 > 0.0) & (g > 0.0) & (h + h1 * meet <= PLAIN_GRAZE)
        if any_of(unsure):
            left, right = (edge, h, h1), (far, g, g1)
            touches, undecided, left, right = _dip(tones, gamma, (phi0 - turns, s0, slope0), unsure, left, right)
            found, plain = found | touches, plain & ~undecided
            tangent = select(touches, left[0] - left[1] / left[2], tangent)
            lo, hi, total = select(touches, left[0], lo), select(touches, right[0], hi), select(touches, turns, total)
            h_lo, h_hi = select(touches, left[1], h_lo), select(touches, right[1], h_hi)
        grazes = searching & ~plain
        searching = searching & ~(found | grazes)
        edge, h, h1, more = step_on(far, t, i, last, clear, v, 1.0, (g, g1))
        turns, i = turns + more, select(searching, branch_after(i, last), i)
    chord = lo + (hi - lo) * h_lo / (h_lo - h_hi)
    x = 0.5 * (chord + tangent)
    x, speed, away = _halley(tones, gamma, (phi0 - total, s0, slope0), x, lo, hi, plain)
    plain = plain & ~away & (x - phi0 + total >= SHORT) & (speed > 0.0)
    return x, total, speed, plain
