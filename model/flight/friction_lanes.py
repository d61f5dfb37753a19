"""Segments of flights with friction side by side: the end of a rise or a fall in each of `kernels.lanes.WIDTH` lanes.

The events are proven as in `model.flight.friction`: every lane walks the branches of its segment by tabulated edges to
the first that holds the end of the segment, a standstill or a landing, and a few Halley steps give all ends together. A
lane whose proof or convergence is not plain is left to `rise` and `fall`.
"""

from __future__ import annotations

from typing import Any

from kernels.lanes import any_of, floor, gather, select, size
from model.flight.branch_walk import branch_after, branch_at, fold_onto, odd, step_on
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.numerics import Floats, Number, inlined, sincos
from model.flight.records import Segment
from model.flight.segment import SHORT, clear_times, height

PLAIN_GRAZE = 1e-9  # heights nearer to the plate than this are left to `fall`
PLAIN_TIME = 0.01  # segments shorter than this are left to the series of `model.flight.segment`
ROUNDS = 10
CONVERGED = 1e-6


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
        Its start, s and s' there and the pull.
    rising, flies
        Masks.

    Returns
    -------
    tau, phase, h, h', stops, plain
    """
    base, last, i = place
    phi0, _, slope0, _, v0, h0, level = segment
    v = gamma * slope0 + v0
    clear, turns = _clear(bounds, gamma, segment, rising)
    edge, h, h1 = phi0, h0 + 0.0 * phi0, v0 - level * turns
    searching, plain = flies, flies
    lo, hi, total = phi0, phi0 + 1.0, turns
    guess = phi0
    stops = rising
    while any_of(searching):
        at = base + TABLE * i
        far = gather(table, at + 3.0)
        t = far - phi0 + turns
        g, g1 = height(gamma, segment, gather(table, at + 4.0), gather(table, at + 5.0), t)
        concave = odd(i)
        width = far - edge
        halts = searching & rising & concave & (g1 <= 0.0)
        lands = searching & ~rising & (g <= 0.0)
        turns_up = searching & ~rising & ~concave & (g > 0.0) & (g1 >= 0.0)
        meet = (g - h - g1 * width) / (h1 - g1)
        grazes = turns_up & ((h + h1 * meet <= PLAIN_GRAZE) | (h1 >= 0.0))
        plain = plain & ~grazes
        halts = halts | (turns_up & ~grazes)
        found = lands | halts
        lo, hi, total = select(found, edge, lo), select(found, far, hi), select(found, turns, total)
        tangent = select(concave, far - g / g1, edge - h / h1)
        chord = edge + width * h / (h - g)
        chord_of_speed = edge + width * h1 / (h1 - g1)
        guess = select(lands, 0.5 * (chord + tangent), select(halts, chord_of_speed, guess))
        stops = (stops | halts) & ~lands
        searching = searching & ~(found | grazes)
        edge, h, h1, more = step_on(far, t, i, last, clear, v, level, (g, g1))
        turns, i = turns + more, select(searching, branch_after(i, last), i)
    x = select((guess > lo) & (guess < hi), guess, 0.5 * (lo + hi))
    return _root(tones, gamma, segment, x, lo, hi, total, stops, plain)


@inlined
def _root(
    tones: Floats, gamma: Number, segment: Segment, x: Number, lo: Number, hi: Number, turns: Number, stops: Any,
    plain: Any,
) -> Any:  # fmt: skip
    """The one root of ``h'`` (where it ``stops``) or of ``h`` in each bracket: Halley, kept inside it."""
    away = plain
    tau, h_end, v_end = x, x, x
    for _ in range(ROUNDS):
        s, slope, q, jerk = 0.0 * x, 0.0 * x, 0.0 * x, 0.0 * x
        for j in range(tones.shape[0]):
            n = tones[j, 0]
            sine, cosine = sincos(n * x + tones[j, 2])
            sine, cosine = tones[j, 1] * sine, tones[j, 1] * n * cosine
            s, slope, q, jerk = s + sine, slope + cosine, q + n * n * sine, jerk + n * n * cosine
        t = x - segment.phase + turns
        h, h1 = height(gamma, segment, s, slope, t)
        h2, h3 = gamma * q - segment.pull, gamma * jerk
        f, f1, f2 = select(stops, h1, h), select(stops, h2, h1), select(stops, h3, h2)
        step = 2.0 * f * f1 / (2.0 * f1 * f1 - f * f2)
        new = x - step
        inside = (new > lo) & (new <= hi)
        gentle = (size(step) <= CONVERGED) & (size(step * f2) <= CONVERGED * size(f1))
        tau = select(away, t - step, tau)
        h_end = select(away, h - step * (h1 - 0.5 * step * h2), h_end)
        v_end = select(away, h1 - step * (h2 - 0.5 * step * h3), v_end)
        x = select(away, select(inside, new, select(new > hi, 0.5 * (x + hi), 0.5 * (x + lo))), x)
        away = away & ~(inside & gentle)
        if not any_of(away):
            break
    clear = (stops & (h_end > PLAIN_GRAZE)) | (~stops & (v_end < 0.0) & (tau >= SHORT))
    return tau, x, h_end, v_end, stops, plain & ~away & clear & (tau >= PLAIN_TIME)


@inlined
def hang_in_lanes(table: Floats, up: Any, down: Any, phi: Number) -> Any:
    """`model.flight.friction.hang` in lanes: ``(rises, waiting time, phase, branch, at a threshold)``.

    ``up`` and ``down`` are the places of each lane's tables and their numbers of edges.
    """
    up_base, up_last = up
    down_base, down_last = down
    at = select(down_last > 0.0, fold_onto(table, down_base, phi), phi)
    i = branch_at(table, down_base, down_last, at)
    stays = (down_last > 0.0) & ~odd(i)
    until = gather(table, down_base + TABLE * (i + 1.0))
    at_up = select(up_last > 0.0, fold_onto(table, up_base, phi), phi)
    k = branch_at(table, up_base, up_last, at_up)
    inside = stays & (up_last > 0.0) & ~odd(k)
    lift = gather(table, up_base + TABLE * (k + 1.0)) - at_up
    lifted = stays & (up_last > 0.0) & ~inside & (lift < until - at)
    falls = stays & ~inside & ~lifted
    above = branch_after(k, up_last)
    wait = select(lifted, lift, select(falls, until - at, 0.0))
    phase = select(inside, at_up, select(lifted, gather(table, up_base + TABLE * above), select(falls, until, at)))
    branch = select(inside, k, select(lifted, above, select(falls, i + 1.0, i)))
    return inside | lifted, wait, phase, branch, lifted | falls
