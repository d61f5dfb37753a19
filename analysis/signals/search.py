"""The next sample that matters, in signals in which mostly nothing happens."""

from __future__ import annotations

import numpy as np

from kernels import njit

AT_ONCE = 64  # samples looked at together for whether any of them matters


@njit()
def first_beyond(x, begin, bound, above):  # type: ignore[no-untyped-def]
    """First place from ``begin`` on where ``x`` (n,) is above the bound, or else below it; n where it never is."""
    while begin < x.shape[0]:
        hits, end = np.int32(0), min(begin + AT_ONCE, x.shape[0])
        if end - begin == AT_ONCE:  # a number of turns that the compiler knows
            at = np.uint64(begin)
            if above:
                for k in range(AT_ONCE):
                    hits += np.int32(x[at + np.uint64(k)] > bound)
            else:
                for k in range(AT_ONCE):
                    hits += np.int32(x[at + np.uint64(k)] < bound)
        if hits or end - begin < AT_ONCE:
            for i in range(begin, end):
                if x[i] > bound if above else x[i] < bound:
                    return i
        begin = end
    return begin
