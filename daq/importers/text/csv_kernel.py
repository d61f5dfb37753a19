"""Numbers out of text, at a few hundred megabytes a second: the inner loop of `daq.importers.text.csv`.

A number comes out as Python's ``float`` would read it, to the last bit, or is left to ``float``.
Decimal to binary: D. Lemire, Software: Practice and Experience 51 (2021) 1700.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernels import njit
from kernels.arrays import Floats, Integers

_FIRST_POWER, _LAST_POWER = -64, 64  # of ten, by table; what lies beyond is left to Python
_EXACT = np.uint64(1 << 53)
_TENS = np.array([float(f"1e{k}") for k in range(23)])
_DIGITS = 19  # decimal digits that 64 bits hold
_TEN = np.uint64(10)
_NEXT, _NOWHERE = np.uint64(1), np.uint64(2**64 - 1)  # places are unsigned: a signed one may count from the end


def powers_of_five() -> NDArray[np.uint64]:
    """Leading 128 bits of ``5**q`` for ``q`` from -64 to 64, shape (129, 2), high word first."""
    rows = []
    for q in range(_FIRST_POWER, _LAST_POWER + 1):
        if q >= 0:
            value = 5**q
            value = (
                value << (128 - value.bit_length())
                if value.bit_length() <= 128
                else value >> (value.bit_length() - 128)
            )
        else:
            power = 5**-q
            bits = (power - 1).bit_length()
            value = (1 << (bits + 127 if q >= -27 else 2 * bits + 128)) // power + 1
            value >>= max(value.bit_length() - 128, 0)
        rows.append((value >> 64, value & (2**64 - 1)))
    return np.array(rows, np.uint64)


_POWERS = powers_of_five()


class Rows(NamedTuple):
    """Numbers read from a block of lines."""

    table: Floats  # (n_columns, rows)
    lines: Integers  # (rows,) Number of the line, from 0, of each row
    left: Integers  # (m, 4) Fields left to Python: row, column, first byte, end
    wrong: int  # Line, from 0, of another width; -1 where there is none


def parse_rows(
    block: NDArray[np.uint8], delimiter: str | None, decimal: str, role_of: Integers, shape: tuple[int, int]
) -> Rows:
    """Numbers of a block of whole lines.

    Parameters
    ----------
    block
        Text as bytes, ending in a newline; blank lines and those that start with ``#`` are passed over.
    delimiter, decimal
        One character each; delimiter None is any run of blanks and tabs.
    role_of
        Place in the table of each column that a line must have, -1 where it is not read, shape (width,).
    shape
        Columns of the table, and the lines of the block.
    """
    table = np.empty(shape)
    lines, left = np.empty(shape[1], np.int64), np.empty((table.size, 4), np.int64)
    limit = ord(delimiter) if delimiter is not None else 0
    n, m, wrong = _parse(block, limit, ord(decimal), role_of, table, lines, left)
    return Rows(table[:, :n], lines[:n], left[:m], wrong)


@njit(inline="always")
def _high_low(a, b):  # type: ignore[no-untyped-def]
    """128-bit product of two 64-bit numbers."""
    low32, shift = np.uint64(0xFFFFFFFF), np.uint64(32)
    a0, a1, b0, b1 = a & low32, a >> shift, b & low32, b >> shift
    p00, p01, p10, p11 = a0 * b0, a0 * b1, a1 * b0, a1 * b1
    middle = (p00 >> shift) + (p01 & low32) + (p10 & low32)
    return p11 + (p01 >> shift) + (p10 >> shift) + (middle >> shift), a * b


@njit()
def _nearest(mantissa, power):  # type: ignore[no-untyped-def]
    """Double nearest to ``mantissa * 10**power``, and whether that is certain (Eisel and Lemire)."""
    one = np.uint64(1)
    zeros = 0
    w = mantissa
    for step in (32, 16, 8, 4, 2, 1):
        if w >> np.uint64(64 - step) == np.uint64(0):
            w <<= np.uint64(step)
            zeros += step
    row = power - _FIRST_POWER
    high, low = _high_low(w, _POWERS[row, 0])
    if high & np.uint64(0x1FF) == np.uint64(0x1FF):
        more, _ = _high_low(w, _POWERS[row, 1])
        before = low
        low = low + more
        if low < before:
            high += one
        if low == np.uint64(0xFFFFFFFFFFFFFFFF):
            return 0.0, False
    upper = high >> np.uint64(63)
    m = high >> (upper + np.uint64(9))
    exponent = ((152170 + 65536) * power >> 16) + 63 + np.int64(upper) - zeros
    if low <= one and -4 <= power <= 23 and m & np.uint64(3) == one and m << (upper + np.uint64(9)) == high:
        m &= ~one
    m = (m + (m & one)) >> one
    return np.float64(np.int64(m)) * 2.0 ** np.float64(exponent - 52), True


@njit(inline="always")
def _digits(block, at, mantissa):  # type: ignore[no-untyped-def]
    """The mantissa with the decimal digits from a place on, and the place after them."""
    digit = block[at] - np.uint8(48)
    while digit <= 9:
        mantissa = mantissa * _TEN + np.uint64(digit)
        at += _NEXT
        digit = block[at] - np.uint8(48)
    return mantissa, at


@njit(inline="always")
def _number(block, start, decimal):  # type: ignore[no-untyped-def]
    """Number that starts at a place, the place after it, and whether it was understood."""
    at = start
    c = block[at]
    negative = c == 45
    if negative or c == 43:
        at += _NEXT
        c = block[at]
    first = at
    mantissa, at = _digits(block, at, np.uint64(0))
    c = block[at]
    digits, point, power = np.int64(at - first), _NOWHERE, np.int64(0)
    if c == decimal:
        point = at
        mantissa, at = _digits(block, at + _NEXT, mantissa)
        c = block[at]
        power = -np.int64(at - point - _NEXT)
        digits -= power
    sure = bool(digits > 0)
    if digits > _DIGITS:  # leading zeros are no digits
        k = first
        while block[k] == 48 or k == point:
            digits -= k != point
            k += _NEXT
        sure = bool(digits <= _DIGITS)
    if c == 101 or c == 69:
        at += _NEXT
        minus = block[at] == 45
        if minus or block[at] == 43:
            at += _NEXT
        exponent, first = np.int64(0), at
        while 48 <= block[at] <= 57 and exponent < 10000:
            exponent = exponent * 10 + (np.int64(block[at]) - 48)
            at += _NEXT
        sure = sure and bool(at > first)
        power += -exponent if minus else exponent
    value = 0.0
    if mantissa == np.uint64(0) or not sure:
        pass
    elif mantissa <= _EXACT and -22 <= power <= 22:  # both doubles are exact, so their quotient is the nearest
        value = np.float64(np.int64(mantissa))
        value = value / _TENS[-power] if power < 0 else value * _TENS[power]
    elif power < _FIRST_POWER or power > _LAST_POWER:
        sure = False
    else:
        value, sure = _nearest(mantissa, power)
    return (-value if negative else value), at, sure


@njit(nogil=True)
def _parse(block, limit, decimal, role_of, table, lines, left):  # type: ignore[no-untyped-def]
    """See `_rows`: what Python calls counts references to arrays, at each number; what a kernel calls does not."""
    return _rows(block, limit, decimal, role_of, table, lines, left)


@njit()
def _rows(block, limit, decimal, role_of, table, lines, left):  # type: ignore[no-untyped-def]
    """Fill in numbers, lines and fields left to Python; returns how many rows and fields, and a line of other width."""
    n = m = line = 0
    width = role_of.shape[0]
    at, size = np.uint64(0), np.uint64(block.shape[0])
    while at < size:
        start = at
        while block[at] == 32 or block[at] == 9 or block[at] == 13:
            at += _NEXT
        if block[at] == 10 or block[at] == 35:  # blank, or a comment
            while block[at] != 10:
                at += _NEXT
            at += _NEXT
            line += 1
            continue
        if limit:  # blanks at the beginning belong to the first field
            at = start
        column = 0
        while True:
            first = at
            wanted = column < width and role_of[column] >= 0
            sure = False
            if wanted:
                while block[at] == 32 or (block[at] == 9 and limit != 9):
                    at += _NEXT
                value, at, sure = _number(block, at, decimal)
                while limit and (block[at] == 32 or (block[at] == 9 and limit != 9)):
                    at += _NEXT
                table[role_of[column], n] = value
            c = block[at]
            while c != 10 and c != 13 and c != limit and (limit or (c != 32 and c != 9)):
                sure = False
                at += _NEXT
                c = block[at]
            if wanted and not sure:
                left[m, 0], left[m, 1], left[m, 2], left[m, 3] = n, role_of[column], first, at
                m += 1
            column += 1
            if not limit:
                while block[at] == 32 or block[at] == 9:
                    at += _NEXT
            if block[at] == 13 or block[at] == 10:
                break
            if limit:
                at += _NEXT
        if column != width or (block[at] == 13 and block[at + _NEXT] != 10):
            return n, m, line
        at += _NEXT + _NEXT if block[at] == 13 else _NEXT
        lines[n] = line
        n += 1
        line += 1
    return n, m, -1
