"""Kinds of arguments: for each there is machine code of its own.

The kind of a value is what numba's type of it depends on, found without numba: of an array the type of its elements,
how many axes it has, how it lies in memory and whether it may be written.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Kind = Any
"""A text, or a tuple of kinds, classes, dtypes and numbers; equal for arguments of which numba's types are equal."""
_WRITEABLE = 0x400
# of ndarray.flags.num: contiguous by rows 1, by columns 2; numba takes an array that is both by rows
_LAYOUTS = {
    written | contiguous: order + ("" if written else " read only")
    for contiguous, order in enumerate("ACFC")
    for written in (0, _WRITEABLE)
}
_FLAGS = _WRITEABLE | 3
_SCALARS = {np.dtype(code).type: np.dtype(code).name for code in "?bBhHiIlLqQfdFD"}
_SCALARS |= {bool: "bool", int: "int64", float: "float64", complex: "complex128", type(None): "none"}


def kind(value: Any) -> Kind:
    """The kind of an argument; all whole numbers of Python's own are 64 bits wide.

    Raises
    ------
    TypeError
        For what no kernel takes.
    """
    given = type(value)
    if given is np.ndarray:
        return value.dtype, value.ndim, _LAYOUTS[value.flags.num & _FLAGS]
    scalar = _SCALARS.get(given)
    if scalar is not None:
        return scalar
    if isinstance(value, tuple):
        return given, *[kind(each) for each in value]
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, _LAYOUTS[value.flags.num & _FLAGS]
    if isinstance(value, np.void):
        return "record", value.dtype
    raise TypeError(
        f"a kernel takes numbers, arrays, records, tuples of them and None; wanted one of these, not {given}"
    )


def text(part: Kind) -> str:
    """A kind in words that are the same in every process, and other ones for a record whose fields are others."""
    if isinstance(part, tuple):
        return f"({', '.join(map(text, part))})"
    if isinstance(part, type):
        return f"{part.__module__}.{part.__qualname__}{getattr(part, '_fields', '')}"
    return repr(part)
