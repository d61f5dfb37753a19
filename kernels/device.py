"""Kernels of the processor, compiled for a graphics processor: one source, two compilations.

A kernel made by `kernels.njit` is compiled anew as a device function of `numba.cuda`, with every kernel that it calls;
functions of lanes (`kernels.lanes`) become those of one number, because there a thread takes the place of a lane.
"""

# numba's inner parts carry no types
# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

import dis
import math
from collections.abc import Callable
from types import CellType, FunctionType
from typing import Any

from kernels import lanes, rows


class NoDevice(ValueError):
    """No graphics processor can be used here."""


def require_device() -> None:
    """Refuse where there is none.

    Raises
    ------
    NoDevice
        With the reason and what to do, in one sentence.
    """
    try:
        from numba import cuda

        found, reason = cuda.is_available(), "no NVIDIA GPU with its driver was found"
    except ImportError as error:  # a numba without its CUDA target
        found, reason = False, f"{error}"
    if not found:
        raise NoDevice(
            f"--device cuda: {reason} on this machine (pip install 'shakerbench[cuda]' brings numba's CUDA target, not "
            "the driver); leave --device out to compute on the processor"
        )


def _select(mask: bool, a: float, b: float) -> float:
    return a if mask else b


def _itself(x: float) -> float:
    return x


def _any_of(mask: bool) -> bool:
    return mask


def _nearest(x: float) -> float:
    return math.floor(x + 0.5)


def _floor(x: float) -> float:
    return float(math.floor(x))


def _root(x: float) -> float:
    return math.sqrt(x)


def _size(x: float) -> float:
    return abs(x)


def _gather(array: Any, index: float) -> float:
    return array[int(index)]  # type: ignore[no-any-return]


def _gather_row(array: Any, index: float) -> Any:
    first = int(index)
    return array[first], array[first + 1], array[first + 2], array[first + 3]


def _max(a: float, b: float) -> float:
    return a if a > b else b


def _min(a: float, b: float) -> float:
    return a if a < b else b


_ONE_NUMBER = {
    id(lanes.select): _select,
    id(lanes.any_of): _any_of,
    id(lanes.nearest): _nearest,
    id(lanes.floor): _floor,
    id(lanes.root): _root,
    id(lanes.size): _size,
    id(lanes.gather): _gather,
    id(rows.gather_rows): _gather_row,
    id(lanes.spread): _itself,
    id(_max): _max,
    id(_min): _min,
}
_OF_TWO = {"max": _max, "min": _min}  # numba's own take any number of arguments, which its CUDA target does not
_made: dict[tuple[int, Any], Any] = {}


def on_device(kernel: Callable[..., Any]) -> Any:
    """The device function of a kernel of the processor, with every kernel that it calls."""
    return remade(kernel, _device_function)


def remade(kernel: Callable[..., Any], wrap: Callable[[FunctionType], Any]) -> Any:
    """A kernel of the processor for one number at a time, it and every kernel that it calls passed through ``wrap``."""
    if (id(kernel), wrap) not in _made:
        source: Any = _ONE_NUMBER.get(id(kernel)) or kernel.py_func  # type: ignore[attr-defined]
        _made[id(kernel), wrap] = wrap(_with_kernels_remade(source, wrap))
    return _made[id(kernel), wrap]


def _device_function(function: FunctionType) -> Any:
    from numba import cuda

    return cuda.jit(device=True)(function)


def _with_kernels_remade(function: Callable[..., Any], wrap: Callable[[FunctionType], Any]) -> FunctionType:
    """A copy of a function in which the kernels that it names are remade."""

    def value_of(value: Any) -> Any:
        return remade(value, wrap) if hasattr(value, "py_func") or id(value) in _ONE_NUMBER else value

    code, given = function.__code__, function.__globals__
    read = _names(code)
    names = {name: value_of(given[name]) for name in read if name in given}
    names |= {name: value_of(of_two) for name, of_two in _OF_TWO.items() if name in read}
    cells = tuple(CellType(value_of(cell.cell_contents)) for cell in function.__closure__ or ())
    return FunctionType(code, {**given, **names}, function.__name__, function.__defaults__, cells or None)


def _names(code: Any) -> set[str]:
    """The global names that a function reads: not the attributes, which may have a kernel's name."""
    return {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}
