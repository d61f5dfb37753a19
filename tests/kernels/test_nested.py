"""Kernels called by kernels: linked into the caller, and nothing else made of them."""

from __future__ import annotations

import gc
import math

import numpy as np
import pytest

from kernels import njit


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
    assert total.signatures and not rooted.signatures and not halved.signatures


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


def test_compiling_leaves_the_collector_as_it_was() -> None:
    """What is set aside while a kernel is compiled is given back to the collector."""
    gc.unfreeze()

    @njit()
    def doubled(x):  # type: ignore[no-untyped-def]
        return 2.0 * x

    assert doubled(2.0) == 4.0
    assert gc.get_freeze_count() == 0
    gc.freeze()
    assert doubled(np.float32(2.0)) == 4.0
    assert gc.get_freeze_count() > 0  # who froze them, keeps them so
    gc.unfreeze()
