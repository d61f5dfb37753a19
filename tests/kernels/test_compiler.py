"""Kernels called by kernels: linked into the caller, nothing else made of them, and no array lost or freed too soon."""

from __future__ import annotations

import gc
import math
import sys
from typing import Any

import numpy as np
import pytest

from kernels import building, compiler, folder, njit


@njit()
def halved(x):  # type: ignore[no-untyped-def]
    """Half of a number; zero is refused."""
    if x == 0.0:
        raise ValueError("zero")
    return 0.5 * x


@njit()
def rooted(values):  # type: ignore[no-untyped-def]
    """Square roots of halves, as a new array."""
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = math.sqrt(halved(values[i]))
    return out


@njit()
def total(values):  # type: ignore[no-untyped-def]
    """Their sum, by two kernels in a row."""
    return rooted(values).sum()


def test_a_called_kernel_is_compiled_for_its_caller_alone() -> None:
    """The answer is that of Python, and no version that Python could call was made of what is called."""
    values = np.array([2.0, 8.0, 18.0])
    assert total(values) == 1.0 + 2.0 + 3.0
    assert total.callables and not rooted.callables and not halved.callables


def test_a_called_kernel_can_be_called_from_python_as_well() -> None:
    """Both ways give the same, whichever came first."""
    assert total(np.array([2.0])) == 1.0
    assert rooted(np.array([2.0])).tolist() == [1.0]
    assert halved(3) == 1.5
    assert total(np.array([8.0])) == 2.0


def test_an_error_of_a_called_kernel_reaches_python() -> None:
    """An exception raised two kernels deep comes out with its message."""
    with pytest.raises(ValueError, match="zero"):
        total(np.array([0.0]))


def test_arrays_made_by_a_called_kernel_are_freed() -> None:
    """A thousand calls that make arrays two kernels deep leave none behind."""
    from numba.core.runtime import _nrt_python, rtsys

    values = np.array([2.0, 8.0])
    total(values)
    _nrt_python.memsys_enable_stats()
    gc.collect()
    before = rtsys.get_allocation_stats()
    for _ in range(1000):
        total(values)
    after = rtsys.get_allocation_stats()
    _nrt_python.memsys_disable_stats()
    assert after.alloc - before.alloc == after.free - before.free


@njit()
def second(rows):  # type: ignore[no-untyped-def]
    """A view of one row, which outlives the function."""
    return rows[1]


@njit()
def doubled_row(rows):  # type: ignore[no-untyped-def]
    """Double a row in place; it makes no array and returns none."""
    row = rows[1]
    for i in range(len(row)):
        row[i] *= 2.0
    return row[0]


@njit()
def copied(rows):  # type: ignore[no-untyped-def]
    """One row, doubled, of a copy made here."""
    own = rows.copy()
    doubled_row(own)
    return second(own)


def test_a_view_handed_on_keeps_its_array_alive() -> None:
    """A row of an array made by a kernel, and handed through another, is still there when Python has it."""
    rows = np.ones((2, 3))
    count = sys.getrefcount(rows)
    for _ in range(1000):
        row = copied(rows)
        np.full((2, 3), 7.0)  # takes the place of what was freed
    assert row.tolist() == [2.0, 2.0, 2.0]
    assert sys.getrefcount(rows) == count
    assert rows.tolist() == [[1.0] * 3] * 2


def test_a_lent_array_is_written_through() -> None:
    """What a kernel that counts no references writes to a view is in the owner's array, whose count is as before."""
    rows = np.ones((2, 3))
    count = sys.getrefcount(rows)

    @njit()
    def twice(values):  # type: ignore[no-untyped-def]
        return doubled_row(values) + doubled_row(values)

    assert twice(rows) == 6.0
    assert sys.getrefcount(rows) == count
    assert rows[1].tolist() == [4.0] * 3


def test_references_are_counted_only_where_an_array_is_made_or_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the three kernels below one, that which makes an array and that which returns a view count references."""
    lent: dict[str, bool] = {}
    borrows = compiler._only_borrows

    def told(state: Any) -> bool:
        lent[state.func_id.func_name] = borrows(state)
        return lent[state.func_id.func_name]

    monkeypatch.setattr(compiler, "_only_borrows", told)
    monkeypatch.setattr(folder, "read", lambda name: None)  # nothing is kept: all is compiled

    def kernels() -> tuple[Any, ...]:
        @njit()
        def made(n):  # type: ignore[no-untyped-def]
            return np.empty(n).size

        @njit()
        def first(rows):  # type: ignore[no-untyped-def]
            return rows[0]

        @njit()
        def summed(row):  # type: ignore[no-untyped-def]
            total = 0.0
            for i in range(len(row)):
                total += row[i]
            return total

        @njit()
        def whole(rows):  # type: ignore[no-untyped-def]
            return summed(first(rows)) + made(2)

        return made, first, summed, whole

    assert kernels()[-1](np.ones((2, 3))) == 5.0
    assert lent == {"made": False, "first": False, "summed": True}


def test_a_release_of_numba_that_was_not_tried_compiles_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where numba's private interfaces may be others, kernels that call kernels give the same numbers and errors, and
    none of their machine code is kept."""
    kept: list[str] = []
    monkeypatch.setattr(folder, "read", lambda name: None)
    monkeypatch.setattr(folder, "write", lambda name, data: kept.append(name))
    values = np.linspace(0.1, 9.0, 100)
    own = total(values)
    kept.clear()
    monkeypatch.setattr(building, "TESTED", ((0, 1), (0, 2)))
    monkeypatch.delattr(compiler, "KernelCompiler")
    caches = building.private_interfaces, building.dispatcher_of
    for cache in caches:
        cache.cache_clear()
    try:
        plain = njit(**total.targetoptions)(total.py_func)
        assert plain(values) == own
        with pytest.raises(ValueError, match="zero"):
            plain(np.array([0.0]))
        assert kept == []
    finally:
        for cache in caches:
            cache.cache_clear()
