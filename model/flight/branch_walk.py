"""Walking the branches of a flight in lanes: the branch of a phase in a table of edges, and the one after a branch.

A table (`model.flight.edge_table`) is named by its place and the number of its edges, of each lane its own.
"""

from __future__ import annotations

from typing import Any

from kernels.arrays import Floats
from kernels.lanes import any_of, floor, gather, select
from model.flight.branches import TWO_PI
from model.flight.edge_table import TABLE
from model.flight.numerics import Number, inlined


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
def odd(i: Number) -> Any:
    """Whether a whole number is odd: a concave branch."""
    return (i - 2.0 * floor(0.5 * i)) == 1.0


@inlined
def branch_after(i: Number, last: Number) -> Number:
    """The next of a table's branches, round and round."""
    return select(i + 1.0 >= last, 0.0, i + 1.0)


@inlined
def step_on(far: Number, t: Number, i: Number, last: Number, clear: Any, v: Number, level: Number, end: Any) -> Any:
    """From the ``end`` (h, h') of a branch, at ``far`` and ``t`` after the start, on to the next branch.

    Whole turns during which the ball is surely above the plate (between the times ``clear``) are left out.

    Returns
    -------
    phase, h, h', turns
        Of the next branch's start; the turns, in radians, are those to be added.
    """
    h, h1 = end
    clear_from, clear_to = clear
    skips = (t > clear_from) & (t < clear_to)
    skipped = select(skips, TWO_PI * floor((clear_to - t) * (1.0 / TWO_PI) + 1.0), 0.0)
    wraps = i + 1.0 >= last
    phase, turns = select(wraps, far - TWO_PI, far), select(wraps, skipped + TWO_PI, skipped)
    return phase, h + skipped * (v - level * (t + 0.5 * skipped)), h1 - level * skipped, turns
