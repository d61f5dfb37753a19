"""Kinds of arguments are equal where numba's types are, and only there."""

from __future__ import annotations

import enum
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from kernels import njit
from kernels.kernel import kind, text


class Pair(NamedTuple):
    """Two of anything."""

    first: Any
    second: Any


class Count(enum.IntEnum):
    """What no kernel takes."""

    ONE = 1


ROWS = np.arange(12.0).reshape(3, 4)
LOCKED = np.arange(3.0)
LOCKED.flags.writeable = False
RECORD = np.dtype([("t_s", "f8"), ("n", "i4")])
VALUES: tuple[Any, ...] = (
    *(None, True, np.True_, 2, np.int64(2), np.int32(2), np.uint8(2), 2.0, np.float64(2.0), np.float32(2.0), 2j),
    *(ROWS, ROWS.T, ROWS[:, 1], ROWS[0], ROWS[:, 1:], ROWS[:1].T, np.float32(ROWS), ROWS.astype(int), LOCKED),
    *(ROWS > 1.0, np.zeros(2, RECORD), np.zeros(2, np.dtype(RECORD.descr, align=True)), np.zeros(1, RECORD)[0]),
    *((1, 2.0), (2.0, 1), (1, (2.0, ROWS)), Pair(1, 2.0), Pair(ROWS, ROWS.T), Pair(Pair(1, 2), None)),
)


def test_two_kinds_are_equal_where_numbas_types_are() -> None:
    """Each pair of arguments shares machine code exactly where numba would let it, in this process and on disk."""
    for one in VALUES:
        for other in VALUES:
            same = numba.typeof(one) == numba.typeof(other)
            assert (kind(one) == kind(other)) is same, (one, other)
            assert (text(kind(one)) == text(kind(other))) is same, (one, other)


def test_a_record_with_its_fields_in_another_order_is_another_kind() -> None:
    """Code that reads a field by its place is not run for a record in which another field stands there."""
    other = type(Pair.__name__, (tuple,), {"__module__": Pair.__module__, "_fields": ("second", "first")})
    assert text(kind(Pair(1, 2))) != text(kind(other((1, 2))))


def test_what_no_kernel_takes_is_refused_with_what_it_takes() -> None:
    """A list, a text and a member of an enumeration are errors that say so."""
    for value in ([1.0], "text", Count.ONE):
        with pytest.raises(TypeError, match="a kernel takes numbers, arrays"):
            kind(value)


def test_arguments_by_name_and_left_out_are_put_in_place() -> None:
    """A kernel is called as the function that it is made of; what does not fit is refused by name."""

    @njit()
    def line(x: float, slope: float, zero: float = 1.0) -> float:
        return slope * x + zero

    assert line(2.0, slope=3.0) == 7.0
    assert line(slope=3.0, x=2.0, zero=0.0) == 6.0
    with pytest.raises(TypeError, match="slope"):
        line(2.0)
