"""Inner loops of `daq.lock_in`: sums over values, and inverses of normal matrices.

``sums`` are normal matrices (sorts, p, p), right sides (sorts, p, channels), sums of squares (sorts, channels) and
numbers of values (sorts,). They run along memory, so that the processor takes several values at a time.
"""

from __future__ import annotations

import numpy as np

from kernels import njit

RESYNC = 512  # samples between exact restarts of the rotating phasors: rounding stays below 1e-13


@njit(error_model="numpy")
def turns(cycles, cosine, sine):  # type: ignore[no-untyped-def]
    """Cosine and sine (k, n) of the turns of tones over 0 to n - 1 values, ``cycles`` (k,) in each."""
    for j in range(cycles.shape[0]):
        step, turn = np.exp(2j * np.pi * cycles[j]), 1.0 + 0j
        for i in range(cosine.shape[1]):
            cosine[j, i], sine[j, i] = turn.real, turn.imag
            turn *= step


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def accumulate(x, sort, first, cycles, response, sums):  # type: ignore[no-untyped-def]
    """Add the normal equations of the rows of ``x`` to those of their sort.

    In each stretch of `RESYNC` values those of one sort stand together, so that the sums run along memory.
    """
    grams, sides, squares, counts = sums
    n, channels = x.shape
    k, sorts = cycles.shape[0], grams.shape[0]
    p = 2 * k + 1
    rows = np.empty((p + channels, RESYNC + 8))  # not a power of two: rows must not share cache lines' places
    ends = np.empty(sorts + 1, dtype=np.int64)
    order = np.empty(RESYNC, dtype=np.uint64)  # unsigned: signed indices may count from the end, and are not vectorised
    cosine, sine = np.empty((k, min(RESYNC, n))), np.empty((k, min(RESYNC, n)))
    turns(cycles, cosine, sine)
    for begin in range(0, n, RESYNC):
        size = min(RESYNC, n - begin)
        ends[:] = 0
        for i in range(begin, begin + size):
            if sort[i] >= 0:
                ends[sort[i] + 1] += 1
        for s in range(sorts):
            counts[s] += ends[s + 1]
            ends[s + 1] += ends[s]
        used = ends[sorts]
        for i in range(size):
            s = sort[begin + i]
            if s >= 0:
                order[ends[s]] = i
                ends[s] += 1
        rows[0, :used] = 1.0
        for j in range(k):
            phase = cycles[j] * (first + begin)
            start = np.exp(2j * np.pi * (phase - np.floor(phase))) * response[j]
            a, b = start.real, start.imag
            for at in range(used):
                c, d = cosine[j, order[at]], sine[j, order[at]]
                rows[2 * j + 1, at] = a * c - b * d
                rows[2 * j + 2, at] = -(a * d + b * c)
        for c in range(channels):
            for at in range(used):
                rows[p + c, at] = x[begin + order[at], c]
        start_at = 0
        for s in range(sorts):
            stop = ends[s]
            if stop > start_at:
                _add_products(rows, start_at, stop, grams[s], sides[s], squares[s])
            start_at = stop
    for s in range(sorts):
        for a in range(p):
            for b in range(a):
                grams[s, b, a] = grams[s, a, b]


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _add_products(rows, start, stop, gram, side, square):  # type: ignore[no-untyped-def]
    """Add products summed over columns ``start`` to ``stop``: tones with tones, channels with tones and themselves."""
    n = rows.shape[0]
    for a in range(0, n, 2):  # two by two: each value that is read is used twice
        a0, a1 = rows[a, start:stop], rows[min(a + 1, n - 1), start:stop]
        for b in range(0, a + 1, 2):
            b0, b1 = rows[b, start:stop], rows[min(b + 1, n - 1), start:stop]
            first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
            for i in range(a0.size):
                first += a0[i] * b0[i]
                second += a0[i] * b1[i]
                third += a1[i] * b0[i]
                fourth += a1[i] * b1[i]
            _add_product(a, b, first, gram, side, square)
            if b + 1 <= a:
                _add_product(a, b + 1, second, gram, side, square)
            if a + 1 < n:
                _add_product(a + 1, b, third, gram, side, square)
                _add_product(a + 1, b + 1, fourth, gram, side, square)


@njit(error_model="numpy")
def _add_product(a, b, total, gram, side, square):  # type: ignore[no-untyped-def]
    """Add a product of rows ``b <= a``: tones come first, then channels."""
    p = gram.shape[0]
    if a < p:
        gram[a, b] += total
    elif b < p:
        side[b, a - p] += total
    elif a == b:
        square[a - p] += total


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def add_stretches(x, edges, cycles, response, sums):  # type: ignore[no-untyped-def]
    """Add the normal equations of successive whole stretches of one channel, each to a sort of its own.

    What tones have in common over an unbroken stretch is known in closed form: only sums with ``x`` are left.
    """
    grams, sides, squares, counts = sums
    k = cycles.shape[0]
    longest = min(RESYNC, x.shape[0])
    cosine, sine = np.empty((k, longest)), np.empty((k, longest))
    turns(cycles, cosine, sine)
    at = np.empty(k, dtype=np.complex128)
    for s in range(edges.shape[0] - 1):
        start, stop = edges[s], edges[s + 1]
        counts[s] += stop - start
        for begin in range(start, stop, RESYNC):
            values = x[begin - edges[0] : min(begin + RESYNC, stop) - edges[0]]
            _phases(cycles, begin, response, at)
            total, square = 0.0, 0.0
            for i in range(values.size):
                total += values[i]
                square += values[i] * values[i]
            sides[s, 0, 0] += total
            squares[s, 0] += square
            for j in range(k):
                c, d = cosine[j, : values.size], sine[j, : values.size]
                along, across = 0.0, 0.0
                for i in range(values.size):
                    along += values[i] * c[i]
                    across += values[i] * d[i]
                sides[s, 2 * j + 1, 0] += at[j].real * along - at[j].imag * across
                sides[s, 2 * j + 2, 0] -= at[j].real * across + at[j].imag * along
        _phases(cycles, start, response, at)
        _add_common(at, cycles, stop - start, grams[s])


@njit(error_model="numpy")
def _phases(cycles, sample, response, at):  # type: ignore[no-untyped-def]
    """Each tone at a sample, after the boxcar."""
    for j in range(cycles.shape[0]):
        phase = cycles[j] * sample
        at[j] = np.exp(2j * np.pi * (phase - np.floor(phase))) * response[j]


@njit(error_model="numpy")
def _sum_of_turns(cycles, n):  # type: ignore[no-untyped-def]
    """Sum of ``exp(2 pi i cycles m)`` over m from 0 to n - 1."""
    half = np.pi * (cycles - np.rint(cycles))
    if half == 0.0:
        return n + 0j
    return np.exp(1j * half * (n - 1)) * (np.sin(half * n) / np.sin(half))


@njit(error_model="numpy")
def _add_common(at, cycles, n, gram):  # type: ignore[no-untyped-def]
    """Add the normal matrix of ``n`` values in a row, at the first of which the tones are ``at`` (k,)."""
    gram[0, 0] += n
    for j in range(at.shape[0]):
        row = 2 * j + 1
        mean = at[j] * _sum_of_turns(cycles[j], n)
        gram[row, 0] += mean.real
        gram[0, row] += mean.real
        gram[row + 1, 0] -= mean.imag
        gram[0, row + 1] -= mean.imag
        for m in range(at.shape[0]):
            column = 2 * m + 1
            above = 0.5 * at[j] * at[m] * _sum_of_turns(cycles[j] + cycles[m], n)
            below = 0.5 * at[j] * np.conj(at[m]) * _sum_of_turns(cycles[j] - cycles[m], n)
            gram[row, column] += below.real + above.real
            gram[row, column + 1] += below.imag - above.imag
            gram[row + 1, column] -= below.imag + above.imag
            gram[row + 1, column + 1] += below.real - above.real


@njit()
def add_sorts(chosen, sums, total):  # type: ignore[no-untyped-def]
    """Add the sums of the ``chosen`` sorts, one after the other, to those of the only sort of ``total``."""
    grams, sides, squares, counts = sums
    gram, side, square, count = total
    for s in chosen:
        count[0] += counts[s]
        for a in range(grams.shape[1]):
            for b in range(grams.shape[2]):
                gram[0, a, b] += grams[s, a, b]
            for c in range(sides.shape[2]):
                side[0, a, c] += sides[s, a, c]
        for c in range(squares.shape[1]):
            square[0, c] += squares[s, c]


@njit(error_model="numpy")
def invert(grams, inverses):  # type: ignore[no-untyped-def]
    """Inverses of normal matrices (m, p, p) by Cholesky factors, each scaled to a unit diagonal before.

    Returns the first that has none in double precision (condition number of 1e10 or more), -1 where all have.
    """
    p = grams.shape[1]
    scale, root, left = np.empty(p), np.zeros((p, p)), np.zeros((p, p))
    for m in range(grams.shape[0]):
        gram, inverse = grams[m], inverses[m]
        for i in range(p):
            scale[i] = 1.0 / np.sqrt(max(gram[i, i], 1e-300))
        norm = 0.0
        for i in range(p):
            size = 0.0
            for j in range(p):
                size += abs(gram[i, j]) * scale[i] * scale[j]
            norm = max(norm, size)
        for j in range(p):
            for i in range(j, p):
                total = gram[i, j] * scale[i] * scale[j]
                for k in range(j):
                    total -= root[i, k] * root[j, k]
                if i > j:
                    root[i, j] = total / root[j, j]
                elif total > 0.0:
                    root[j, j] = np.sqrt(total)
                else:
                    return m
        for j in range(p):  # rows of ``left``: columns of the factor's inverse
            left[j, j] = 1.0 / root[j, j]
            for i in range(j + 1, p):
                total = 0.0
                for k in range(j, i):
                    total -= root[i, k] * left[j, k]
                left[j, i] = total / root[i, i]
        back = 0.0
        for i in range(p):
            size = 0.0
            for j in range(p):
                total = 0.0
                for k in range(max(i, j), p):
                    total += left[i, k] * left[j, k]
                inverse[i, j] = total * scale[i] * scale[j]
                size += abs(total)
            back = max(back, size)
        if not norm * back < 1e10:
            return m
    return -1
