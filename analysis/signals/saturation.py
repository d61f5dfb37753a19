"""A reading that stands still at its largest or smallest value: sensor or converter are at their end.

The tones of what is cut off are too small, and no fit can tell. Impacts that are cut off for some samples do no harm.
"""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from kernels import njit

STANDS = 0.02  # share of the samples at an end from which it saturates: a sine cut off there has lost 0.2 % of its peak
CROWDED = 4.0  # times as many as at the next value; at the end of a sine there are 2.4 times as many


def share_at_an_end(values: npt.NDArray[Any]) -> float:
    """Share of ``values`` (n,) at the largest or the smallest one, where a signal that turns there would have fewer."""
    ends = _counts_at_ends(values)
    return float(sum(at for at, beside in ends if at > CROWDED * beside)) / len(values)


@njit()
def _counts_at_ends(values):  # type: ignore[no-untyped-def]
    """Counts of the smallest value and of the next one, and those of the largest; zeros where all are the same."""
    low = high = values[0]
    for v in values:
        low, high = min(low, v), max(high, v)
    if low == high:
        return (0, 0), (0, 0)  # a channel that shows nothing is another matter
    after, before = high, low
    for v in values:
        after = min(after, v if v > low else high)
        before = max(before, v if v < high else low)
    at_low, at_after, at_before, at_high = 0, 0, 0, 0
    for v in values:
        at_low += v == low
        at_after += v == after
        at_before += v == before
        at_high += v == high
    return (at_low, at_after), (at_high, at_before)
