"""Segments of flights with friction side by side: the end of a rise or a fall in each of `kernels.lanes.WIDTH` lanes.

The events are proven as in `model.flight.friction`: every lane walks the branches of its segment by tabulated edges to
the first that holds the end of the segment, a standstill or a landing, and a few Halley steps give all ends together. A
lane whose proof or convergence is not plain is left to `rise` and `fall`.
"""

from __future__ import annotations

from typing import Any

from kernels.lanes import any_of, floor, gather, root, select, size
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.numerics import Floats, Number, inlined, sincos
from model.flight.records import Segment
from model.flight.segment import SHORT, height

PLAIN_GRAZE = 1e-9  # heights nearer to the plate than this are left to `fall`
PLAIN_TIME = 0.01  # segments shorter than this are left to the series of `model.flight.segment`
ROUNDS = 10
CONVERGED = 1e-6


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
        Of each lane the place of its table in ``table`` and the number of its edges.
    segment
        Its start, s and s' there and the pull.
    rising, flies
        Masks.

    Returns
    -------
    tau, phase, h, h', stops, plain
    """
    highest, fastest = bounds
    base, last = place
    phi0, s0, slope0, _, v0, h0, level = segment
    v_mean = gamma * slope0 + v0
    discriminant = v_mean * v_mean - 2.0 * level * (gamma * (highest - s0) - h0)
    r = root(select(discriminant > 0.0, discriminant, 0.0))
    clear_from = (v_mean - r) / level
    falling = (v_mean + gamma * fastest) / level
    clear_from = select(clear_from > falling, clear_from, falling)
    clear_to = select(rising | (discriminant <= 0.0), -1.0, (v_mean + r) / level - TWO_PI)
    sure = (v_mean - gamma * fastest) / level
    turns = select(rising & (sure > 0.0), TWO_PI * floor(sure * (1.0 / TWO_PI)), 0.0)
    i = 0.0 * phi0
    edge, h, h1 = phi0, h0 + 0.0 * phi0, v0 - level * turns
    searching, plain = flies, flies
    lo, hi, total = phi0, phi0 + 1.0, turns
    guess = phi0
    stops = rising
    while any_of(searching):
        at = base + TABLE * i
        far = gather(table, at + 3.0)
        t = far - phi0 + turns
        behind = (far <= phi0) & (turns == 0.0)
        g, g1 = height(gamma, segment, gather(table, at + 4.0), gather(table, at + 5.0), t)
        odd = (i - 2.0 * floor(0.5 * i)) == 1.0
        width = far - edge
        ahead = searching & ~behind
        halts = ahead & rising & odd & (g1 <= 0.0)
        lands = ahead & ~rising & (g <= 0.0)
        turns_up = ahead & ~rising & ~odd & (g > 0.0) & (g1 >= 0.0)
        meet = (g - h - g1 * width) / (h1 - g1)
        grazes = turns_up & ((h + h1 * meet <= PLAIN_GRAZE) | (h1 >= 0.0))
        plain = plain & ~grazes
        halts = halts | (turns_up & ~grazes)
        found = lands | halts
        lo, hi, total = select(found, edge, lo), select(found, far, hi), select(found, turns, total)
        tangent = select(odd, far - g / g1, edge - h / h1)
        chord = edge + width * h / (h - g)
        chord_of_speed = edge + width * h1 / (h1 - g1)
        guess = select(lands, 0.5 * (chord + tangent), select(halts, chord_of_speed, guess))
        stops = (stops | halts) & ~lands
        searching = searching & ~(found | grazes)
        wraps = (i + 1.0) == last
        skips = (t > clear_from) & (t < clear_to) & ~behind
        skipped = select(skips, TWO_PI * floor((clear_to - t) * (1.0 / TWO_PI) + 1.0), 0.0)
        i = select(searching, select(wraps, 0.0, i + 1.0), i)
        edge = select(behind, edge, select(wraps, far - TWO_PI, far))
        turns = turns + select(wraps, TWO_PI, 0.0) + skipped
        skipped_h = g + gamma * slope0 * skipped + v0 * skipped - 0.5 * level * skipped * (2.0 * t + skipped)
        h = select(behind, h, select(skips, skipped_h, g))
        h1 = select(behind, h1, g1 - level * skipped)
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
def fold_onto(table: Floats, base: Number, phi: Number) -> Number:
    """``phi`` shifted by whole turns onto a table's period."""
    first = gather(table, base)
    folded = phi - TWO_PI * floor((phi - first) * (1.0 / TWO_PI))
    folded = select(folded < first, folded + TWO_PI, folded)
    return select(folded >= first + TWO_PI, folded - TWO_PI, folded)


@inlined
def branch_at(table: Floats, base: Number, last: Number, phi: Number) -> Number:
    """`model.flight.branches.branch_of` in a table."""
    i = 0.0 * phi
    after = (i + 1.0 < last) & (phi >= gather(table, base + TABLE))
    while any_of(after):
        i = select(after, i + 1.0, i)
        after = after & (i + 1.0 < last) & (phi >= gather(table, base + TABLE * (i + 1.0)))
    return i


@inlined
def hang_in_lanes(table: Floats, up: Any, down: Any, phi: Number) -> Any:
    """`model.flight.friction.hang` in lanes: ``(rises, waiting time, phase, at a threshold)``.

    ``up`` and ``down`` are the places of each lane's tables and their numbers of edges.
    """
    up_base, up_last = up
    down_base, down_last = down
    at = select(down_last > 0.0, fold_onto(table, down_base, phi), phi)
    i = branch_at(table, down_base, down_last, at)
    stays = (down_last > 0.0) & ((i - 2.0 * floor(0.5 * i)) == 0.0)
    until = gather(table, down_base + TABLE * (i + 1.0))
    wait = select(stays, until - at, 0.0)
    at_up = select(up_last > 0.0, fold_onto(table, up_base, phi), phi)
    k = branch_at(table, up_base, up_last, at_up)
    inside = stays & (up_last > 0.0) & ((k - 2.0 * floor(0.5 * k)) == 0.0)
    lift = gather(table, up_base + TABLE * (k + 1.0))
    lifted = stays & (up_last > 0.0) & ~inside & (lift - at_up < wait)
    wait = select(inside, 0.0, select(lifted, lift - at_up, wait))
    phase = select(inside, at_up, select(lifted, fold_onto(table, up_base, lift), at))
    phase = select(stays & ~inside & ~lifted, fold_onto(table, down_base, until), phase)
    return inside | lifted, wait, phase, stays & ~inside
