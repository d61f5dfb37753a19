"""A kernel: a Python function that runs as machine code, found or made at the first call with each kind of arguments.

The kind of a value is what numba's type of it depends on, found without numba: of an array the type of its elements,
how many axes it has, how it lies in memory and whether it may be written. Nothing of numba is imported before
something is to be compiled.

numba's own cache looks at the file in which a function stands, not at the functions it calls, and so runs stale code
after an edit of one of those. Here a stored kernel's name is a hash of its bytecode and constants and those of every
function it reaches (`kernels.folder`), of the kinds of its arguments, of the processor, of numba's settings in the
environment and of the sources of this package `kernels`. The folder carries the versions of numba, llvmlite, Python
and shakerbench. Any number of processes may use it at once: a file is written whole under its final name or not at
all, and its name fixes its content.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from kernels import folder
from kernels.folder import fingerprint, fingerprint_of_sources

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
    """A ``function`` that runs as machine code; ``options`` as `numba.njit` takes them.

    Both are `py_func` and `targetoptions`, as in numba's own dispatcher; `callables` holds the machine code in use, by
    the kinds of the arguments (`kind`).
    """

    def __init__(self, function: Function, options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.targetoptions = function, options
        self.callables: dict[tuple[Kind, ...], Function] = {}
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
            code = self.callables[kinds] = machine_code_of(self, kinds, arguments)
        return code(*arguments)

    def __reduce__(self) -> str:
        """Another process finds it under its name."""
        return str(self.py_func.__qualname__)


DIGEST_BYTES = 32
_one_at_a_time = threading.RLock()


def njit(**options: Any) -> Callable[[Function], Any]:
    """Compile a function at its first call, and keep the machine code for later processes.

    Returns the decorator, which gives a `Kernel`; with ``NUMBA_DISABLE_JIT`` set, the function as it is.

    Parameters
    ----------
    **options
        As `numba.njit` takes them; ``cache`` has no effect: it is always on.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return lambda function: function
    return lambda function: Kernel(function, options)


def machine_code_of(kernel: Kernel, kinds: tuple[Kind, ...], arguments: tuple[Any, ...]) -> Function:
    """What runs ``kernel`` for arguments of the given kinds, of which ``arguments`` are an example."""
    from kernels import machine_code  # an import of the program needs nothing of it

    with _one_at_a_time:
        name = _name(kernel, kinds)
        data = folder.read(name)
        code = None
        if data is not None and hashlib.sha256(data[DIGEST_BYTES:]).digest() == data[:DIGEST_BYTES]:
            code = machine_code.load(data[DIGEST_BYTES:])
        if code is None:  # not there, or damaged: it is written over
            from kernels import building  # imports numba

            code, stored = building.build(kernel, arguments)
            if stored is not None:
                folder.write(name, hashlib.sha256(stored).digest() + stored)
        return code


def _name(kernel: Kernel, kinds: tuple[Kind, ...]) -> str:
    """The file's name: the function's for a person, and the hash."""
    # numba's settings change what a kernel compiles to, but for the one that names the folder
    numba = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_") and item[0] != folder.GIVEN)
    made_of = repr((fingerprint(kernel), text(kinds), (*_machine(), numba)))
    return f"{kernel.py_func.__module__}.{kernel.py_func.__name__}-{hashlib.sha256(made_of.encode()).hexdigest()[:32]}"


@functools.cache
def _machine() -> tuple[str, ...]:
    """The processor, and the hash of the sources that compile."""
    from llvmlite import binding

    paths = sorted(Path(__file__).parent.rglob("*.py"))
    own = fingerprint_of_sources(path.read_text(encoding="utf-8") for path in paths)
    features = binding.get_host_cpu_features().flatten()
    return binding.get_process_triple(), binding.get_host_cpu_name(), features, own
