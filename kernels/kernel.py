"""A kernel: a Python function that runs as machine code, found or made at the first call with each kind of arguments.

Nothing of numba is imported before something is to be compiled.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable
from typing import Any

from kernels.arguments import Kind, kind

Function = Callable[..., Any]


class Kernel:
    """A function that runs as machine code.

    Parameters
    ----------
    function
        What is compiled.
    options
        As `numba.njit` takes them.

    Attributes
    ----------
    py_func, targetoptions
        Function and options, under the names that numba's own dispatcher has for them.
    callables : dict
        The machine code in use, by the kinds of the arguments (`kernels.arguments.kind`).
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
            from kernels import store  # nothing of it is needed by an import alone

            code = self.callables[kinds] = store.machine_code_of(self, kinds, arguments)
        return code(*arguments)

    def __reduce__(self) -> str:
        """Another process finds it under its name."""
        return str(self.py_func.__qualname__)


def njit(**options: Any) -> Callable[[Function], Any]:
    """Compile a function at its first call, and keep the machine code for later processes.

    Parameters
    ----------
    **options
        As `numba.njit` takes them; ``cache`` has no effect: it is always on.

    Returns
    -------
    callable
        The decorator, which gives a `Kernel`; with ``NUMBA_DISABLE_JIT`` set, the function as it is.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return lambda function: function
    return lambda function: Kernel(function, options)
