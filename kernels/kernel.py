"""A kernel: a Python function that runs as machine code, found or made at the first call with each kind of arguments.

The kind of a value is what numba's type of it depends on, found without numba: of an array the type of its elements,
how many axes it has, how it lies in memory and whether it may be written. Nothing of numba is imported before
something is to be compiled.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

Function = Callable[..., Any]
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

    Raises `TypeError` for what no kernel takes.
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


class Watcher(Protocol):
    """Is called for each function that is compiled, also for those within others."""

    def on_start(self, name: str) -> None:
        """The function of that name begins."""

    def on_end(self) -> None:
        """The one that began last is done."""


watchers: list[Watcher] = []
"""Whoever is to know when kernels are being compiled."""


class Kernel:
    """A function that runs as machine code.

    Parameters
    ----------
    function
        What is compiled.
    options
        As `numba.njit` takes them.
    find
        Finds or makes the machine code of a kernel for arguments of given kinds, of which it gets an example.

    Attributes
    ----------
    py_func, targetoptions
        Function and options, under the names that numba's own dispatcher has for them.
    callables : dict
        The machine code in use, by the kinds of the arguments (`kind`).
    """

    def __init__(self, function: Function, options: dict[str, Any], find: Finder) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.targetoptions = function, options  # numba's own dispatcher has these names for them
        self.callables: dict[tuple[Kind, ...], Function] = {}  # machine code in use, by the arguments' kinds
        self._find = find
        self._count: int = function.__code__.co_argcount

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Run it; the first time with arguments of these kinds, find or make the machine code."""
        if named or len(arguments) != self._count:
            bound = inspect.signature(self.py_func).bind(*arguments, **named)
            bound.apply_defaults()
            arguments = bound.args
        kinds = tuple([kind(argument) for argument in arguments])
        code = self.callables.get(kinds)
        if code is None:
            code = self.callables[kinds] = self._find(self, kinds, arguments)
        return code(*arguments)

    def __reduce__(self) -> str:
        """Another process finds it under its name."""
        return str(self.py_func.__qualname__)


Finder = Callable[[Kernel, tuple[Kind, ...], tuple[Any, ...]], Function]
