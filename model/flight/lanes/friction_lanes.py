"""Segments of flights with friction side by side, an orbit in each of `kernels.lanes.WIDTH` lanes.

While the ball moves under the pull ``level``, its speed relative to the plate is ``h' = m - F(phi)`` with

    F(phi) = gamma s'(phi) + level phi,

the plate's speed as the freely moving ball sees it, and ``m`` steady: where the ball stands still depends on no height.
``F`` is monotone between the edges of the tables, so a rise ends in the first concave branch at whose end ``F`` has
come up to ``m``, a fall stands still in the first convex one at whose end it has gone down to ``m``; a turn adds
``2 pi level`` to ``F``, so either is a comparison with the edges of one period. Until it stands still a ball falls
ever lower: it has landed before if and only if the height there is not positive, and then in the first branch that ends
below the plate. Nothing is walked, and every lane does the same. A few steps of Householder's method give the root; a
lane whose proof or convergence is not plain is left to `model.flight.friction`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from kernels.arrays import Floats
from kernels.lanes import WIDTH, floor, load, root, select, spread
from model.flight.branches import TWO_PI
from model.flight.lanes.plate_lanes import PLAIN_GRAZE, root_in_branch, start_of_root
from model.flight.numerics import Number, Segment, inlined
from model.flight.segment import SHORT, height

PLAIN_TIME = 0.01  # segments shorter than this are left to the series of `model.flight.segment`
TURN = 1.0 / TWO_PI
BRANCH_ROWS = 7
EDGE_ROWS = 3  # phase, s and s' of an edge


class Branch(NamedTuple):
    """A branch of ``h'``: the edges that bound it, ``F`` there, and the shape of ``F`` between."""

    lo: Number
    hi: Number
    seen_lo: Number
    seen_hi: Number
    per_gain: Number
    """1 over the difference of the last two."""
    bend_lo: Number
    """``F'' w^2 / 2`` at the lower edge, w the width of the branch, in units of that difference."""
    bend_hi: Number
    """The same at the upper edge, with the other sign."""


@inlined
def _branch(flat: Floats, row: int) -> Branch:
    """The branch in the rows from ``row`` on."""
    at = row * WIDTH
    return Branch(
        load(flat, at), load(flat, at + WIDTH), load(flat, at + 2 * WIDTH), load(flat, at + 3 * WIDTH),
        load(flat, at + 4 * WIDTH), load(flat, at + 5 * WIDTH), load(flat, at + 6 * WIDTH),
    )  # fmt: skip


@inlined
def _end_of_rise(flat: Floats, rows: Any, phi0: Number, m: Number, level: Number) -> Any:
    """The branch in which a rise ends, and the turns until then."""
    row, windows = rows
    per_turn = 1.0 / (TWO_PI * level)
    found = _branch(flat, row)
    end, turns = spread(math.inf), spread(0.0)
    for w in range(windows):
        branch = _branch(flat, row + BRANCH_ROWS * w)
        after = floor((phi0 - branch.hi) * TURN) + 1.0  # the first such edge that is still to come
        enough = -floor((branch.seen_hi - m) * per_turn)
        more = TWO_PI * select(enough > after, enough, after)
        sooner = branch.hi + more < end
        end, turns, found = (
            select(sooner, branch.hi + more, end), select(sooner, more, turns), select(sooner, branch, found)
        )  # fmt: skip
    return found, turns


@inlined
def _end_of_fall(flat: Floats, rows: Any, phi0: Number, m: Number, level: Number) -> Any:
    """The branch in which a fall stands still, the turns until then, and whether there is one.

    Each edge is looked at once: a turn later ``F`` is larger there.
    """
    row, windows = rows
    found = _branch(flat, row)
    end, turns = spread(math.inf), spread(0.0)
    for w in range(windows):
        branch = _branch(flat, row + BRANCH_ROWS * w)
        more = TWO_PI * (floor((phi0 - branch.hi) * TURN) + 1.0)
        sooner = (branch.seen_hi + level * more <= m) & (branch.hi + more < end)
        end, turns, found = (
            select(sooner, branch.hi + more, end), select(sooner, more, turns), select(sooner, branch, found)
        )  # fmt: skip
    return found, turns, end < math.inf


@inlined
def _start_of_standstill(branch: Branch, m: Number) -> Number:
    """Near where ``F = m`` in a branch: by the polynomial through ``F``, ``F' = 0`` and ``F''`` at both its ends."""
    a2, b2 = branch.bend_lo, branch.bend_hi
    w, y = branch.hi - branch.lo, (m - branch.seen_lo) * branch.per_gain
    a3, a4, a5 = 10.0 - 3.0 * a2 - b2, -15.0 + 3.0 * a2 + 2.0 * b2, 6.0 - a2 - b2
    # from the nearer end on, d away: y = c2 d^2 + c3 d^3, nearly
    low = y < 0.5
    c2 = 1.0 / select(low, a2, b2)
    d = root(select(low, y, 1.0 - y) * c2)
    bent = select(low, a3, a3 + 4.0 * a4 + 10.0 * a5) * c2 * d
    d = d * (1.0 - bent * (0.5 - 0.625 * bent))
    u = select(low, d, 1.0 - d)
    u = select((u > 0.0) & (u < 1.0), u, y)
    f = u * u * (a2 + u * (a3 + u * (a4 + u * a5))) - y
    f1 = u * (2.0 * a2 + u * (3.0 * a3 + u * (4.0 * a4 + u * (5.0 * a5))))
    f2 = 2.0 * a2 + u * (6.0 * a3 + u * (12.0 * a4 + u * (20.0 * a5)))
    new = u - 2.0 * f * f1 / (2.0 * f1 * f1 - f * f2)
    return branch.lo + w * select((new > 0.0) & (new < 1.0), new, u)


@inlined
def _standstill(
    tones: Floats, gamma: Number, segment: Segment, branch: Branch, turns: Number, m: Number, wanted: Any
) -> Any:
    """Where ``h' = 0`` in a branch of every ``wanted`` lane: ``(tau, phase, h, h', (s, s', q), converged)``."""
    phi0, s0, slope0, _, v0, h0, level = segment
    x = _start_of_standstill(branch, m - level * turns)
    take_off = (phi0 - turns, s0, slope0, v0, h0, level)
    bracket = (branch.lo, branch.hi)
    x, (h, v, s, slope, q), away = root_in_branch(tones, gamma, take_off, bracket, x, True, wanted)
    return x - phi0 + turns, x, h, v, (s, slope, q), ~away


@inlined
def rise_in_lanes(tones: Floats, flat: Floats, rows: Any, gamma: Number, segment: Segment, wanted: Any) -> Any:
    """The end of a rise in every ``wanted`` lane.

    ``rows`` are the first row of ``flat`` that holds the branches of rises, and the number of branches. Returns tau,
    phase, h, h', (s, s', q) at the phase, plain.
    """
    m = gamma * segment.slope + segment.speed + segment.pull * segment.phase
    branch, turns = _end_of_rise(flat, rows, segment.phase, m, segment.pull)
    tau, x, h, v, plate, converged = _standstill(tones, gamma, segment, branch, turns, m, wanted)
    return tau, x, h, v, plate, converged & (h > PLAIN_GRAZE) & (tau >= PLAIN_TIME)


@inlined
def fall_in_lanes(tones: Floats, flat: Floats, rows: Any, gamma: Number, segment: Segment, wanted: Any) -> Any:
    """As `rise_in_lanes` for falls; ``(..., lands, plain)``.

    Where the ball lands, tau is the time to the standstill that it does not reach, infinite where there is none.
    """
    m = gamma * segment.slope + segment.speed + segment.pull * segment.phase
    branch, turns, stops = _end_of_fall(flat, rows, segment.phase, m, segment.pull)
    tau, x, h, v, plate, converged = _standstill(tones, gamma, segment, branch, turns, m, wanted & stops)
    lands = ~stops | (converged & (h < -PLAIN_GRAZE))
    plain = lands | (converged & (h > PLAIN_GRAZE) & (tau >= PLAIN_TIME))
    return select(stops, tau, math.inf), x, h, v, plate, lands, plain


@inlined
def _edge(flat: Floats, row: int) -> Any:
    """Phase, s and s' of the edge in the rows from ``row`` on."""
    return load(flat, row * WIDTH), load(flat, (row + 1) * WIDTH), load(flat, (row + 2) * WIDTH)


@inlined
def _branch_of_landing(flat: Floats, rows: Any, gamma: Number, segment: Segment, latest: Number) -> Any:
    """The edges (phase, s, s') between which a fall that lands before the time ``latest`` does so, and the turns.

    At an edge's phase, the height is quadratic in the time.
    """
    row, windows = rows
    phi0, s0, slope0, _, v0, h0, level = segment
    v, per_level = gamma * slope0 + v0, 1.0 / level
    first = _edge(flat, row)
    before, left, right = first, first, first
    end, turns = spread(math.inf), spread(0.0)
    for k in range(2 * windows):
        edge = _edge(flat, row + EDGE_ROWS * (k + 1))
        # the first time to come at that phase; the ball is above the plate's height there between two times
        once = edge[0] - phi0 - TWO_PI * floor((edge[0] - phi0) * TURN)
        square = v * v + 2.0 * level * (h0 + gamma * (s0 - edge[1]))
        r = root(select(square > 0.0, square, 0.0))
        below_from = select(once * level < v - r, 0.0, (v + r) * per_level)
        below_from = select(below_from > 0.0, select(below_from < latest, below_from, latest), 0.0)
        more = -TWO_PI * floor((edge[0] - phi0 - below_from) * TURN)
        sooner = edge[0] + more < end
        end, turns = select(sooner, edge[0] + more, end), select(sooner, more, turns)
        left, right, before = select(sooner, before, left), select(sooner, edge, right), edge
    return left, right, turns


@inlined
def land_in_lanes(
    tones: Floats, flat: Floats, rows: Any, gamma: Number, segment: Segment, stop: Any, wanted: Any
) -> Any:  # fmt: skip
    """Where the falls of the ``wanted`` lanes end on the plate: tau, phase, h', (s, s', q) at the phase, plain.

    ``rows`` are the first row of ``flat`` that holds the edges, from the last of the turn before on, and the windows;
    ``stop`` is where the ball would stand still below the plate: tau (or infinite), h, q.
    """
    phi0, s0, slope0, a0, v0, h0, level = segment
    (lo, s_lo, slope_lo), (hi, s_hi, slope_hi), turns = _branch_of_landing(flat, rows, gamma, segment, stop[0])
    h_lo, v_lo = height(gamma, segment, s_lo, slope_lo, lo - phi0 + turns)
    h_hi, v_hi = height(gamma, segment, s_hi, slope_hi, hi - phi0 + turns)
    begins, a_lo, a_hi = lo + turns <= phi0, 0.0 * phi0, 0.0 * phi0
    lo, h_lo, v_lo, a_lo = select(begins, (phi0 - turns, h0, v0, a0), (lo, h_lo, v_lo, a_lo))
    tau_stop, h_stop, q_stop = stop
    stops = tau_stop < hi - phi0 + turns
    standing = phi0 + tau_stop - turns, h_stop, 0.0 * phi0, gamma * q_stop - level
    hi, h_hi, v_hi, a_hi = select(stops, standing, (hi, h_hi, v_hi, a_hi))
    chord = lo + (hi - lo) * h_lo / (h_lo - h_hi)
    x = start_of_root((lo, h_lo, v_lo, a_lo), (hi, h_hi, v_hi, a_hi), chord)
    take_off = (phi0 - turns, s0, slope0, v0, h0, level)
    x, (_, v, s, slope, q), away = root_in_branch(tones, gamma, take_off, (lo, hi), x, False, wanted)
    tau = x - phi0 + turns
    # a short and slow fall is rounding noise in the plain sum for the height: `SHORT` has its series
    surely = ((v < 0.0) & (tau >= SHORT)) | (v < -0.05)
    plain = ~away & surely & (tau >= PLAIN_TIME) & (h_lo > 0.0) & (h_hi <= 0.0)
    return tau, x, v, (s, slope, q), plain
