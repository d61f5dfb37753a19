"""The hash of a kernel: its bytecode, its constants and options, and those of every kernel it calls.

numba compiles the values of global names into the machine code, so they belong to the hash as the bytecode does. Files
and line numbers do not: a comment, a docstring or a moved function changes nothing.
"""

from __future__ import annotations

import enum
import functools
import hashlib
import re
from collections.abc import Iterable
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from kernels.lanes import Intrinsic

Parts = list[object]
_TEXT = re.compile(r'^[ \t]*("""[\s\S]*?"""|#[^\n]*)?[ \t]*\n|[ \t]+#[^\n]*$', re.MULTILINE)


@functools.cache
def fingerprint(dispatcher: Any) -> str:
    """The hash of a compiled function and of all that it reaches, as hexadecimal digits."""
    parts: Parts = []
    _kernel(dispatcher, parts, {})
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def fingerprint_of_closure(function: FunctionType) -> str:
    """The hash of a function and of what a factory has given it: two of one name differ."""
    parts: Parts = []
    _function(function, parts, {})
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def fingerprint_of_sources(sources: Iterable[str]) -> str:
    """The hash of modules by their code: docstrings, comments and blank lines do not count."""
    # by a pattern: parsing this package takes longer than most kernels run, in each process
    return hashlib.sha256("".join(map(without_text, sources)).encode()).hexdigest()


def without_text(source: str) -> str:
    """A module's source without docstrings, comments and blank lines."""
    return _TEXT.sub("", source)


def _kernel(dispatcher: Any, parts: Parts, seen: dict[int, int]) -> None:
    """Add a compiled function; one met before is named by its number."""
    # kernels that call each other would never end
    if id(dispatcher) in seen:
        parts.append(("met", seen[id(dispatcher)]))
        return
    seen[id(dispatcher)] = len(seen)
    function = dispatcher.py_func
    parts.append(("options", sorted((key, _plain(value)) for key, value in dispatcher.targetoptions.items())))
    _function(function, parts, seen)


def _function(function: FunctionType, parts: Parts, seen: dict[int, int]) -> None:
    parts.append(("function", function.__module__, function.__qualname__))
    _value(function.__defaults__, parts, seen)
    for cell in function.__closure__ or ():
        _value(cell.cell_contents, parts, seen)
    _code(function.__code__, function.__globals__, parts, seen, function.__doc__)


def _code(code: CodeType, names: dict[str, Any], parts: Parts, seen: dict[int, int], text: str | None = None) -> None:
    """Add bytecode, its constants but for the docstring ``text``, and the values of the global names it reads."""
    parts.append(("code", code.co_code, code.co_names, code.co_varnames, code.co_argcount))
    for i, constant in enumerate(code.co_consts):
        if isinstance(constant, CodeType):
            _code(constant, names, parts, seen)
        elif i == 0 and constant == text:  # the docstring comes first; without one its place holds None
            continue
        else:
            _value(constant, parts, seen)
    for value in (names[name] for name in code.co_names if name in names):
        if not isinstance(value, ModuleType):
            _value(value, parts, seen)
            continue
        # of a module only what the code may use of it: attributes stand among the names as well
        parts.append(("module", value.__name__))
        for name in code.co_names:
            if hasattr(value, name):
                _value(getattr(value, name), parts, seen)


def _value(value: Any, parts: Parts, seen: dict[int, int]) -> None:
    """Add a value that numba may compile in."""
    if hasattr(value, "py_func"):  # a kernel, or a function compiled by numba itself
        _kernel(value, parts, seen)
    elif isinstance(value, Intrinsic):
        parts.append(("intrinsic", value.name))
    elif isinstance(value, enum.Enum):
        parts.append((type(value).__qualname__, value.name, value.value))
    elif isinstance(value, type) and issubclass(value, enum.Enum):
        parts.append((value.__qualname__, [(member.name, member.value) for member in value]))
    elif isinstance(value, np.ndarray):
        parts.append(("array", value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()))
    elif isinstance(value, tuple):
        parts.append(("tuple", type(value).__qualname__, len(value)))
        for item in value:
            _value(item, parts, seen)
    else:
        parts.append(_plain(value))


def _plain(value: Any) -> object:
    """A value as it is in every process: no address, no order of a set."""
    if value is None or isinstance(value, int | float | complex | str | bytes | np.generic):
        return type(value).__name__, repr(value)
    if isinstance(value, set | frozenset):
        return "set", sorted(map(repr, value))
    named = getattr(value, "__module__", ""), getattr(value, "__qualname__", getattr(value, "__name__", ""))
    return type(value).__qualname__, *named, *getattr(value, "_fields", ())
