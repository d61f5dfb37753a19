"""A kernel in lanes as a Python function of one number at a time, with every kernel that it calls."""

from __future__ import annotations

import dis
import math
from collections.abc import Callable
from types import CellType, FunctionType
from typing import Any

from kernels import lanes


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


_ONE_NUMBER = {
    id(lanes.select): _select,
    id(lanes.any_of): _any_of,
    id(lanes.nearest): _nearest,
    id(lanes.floor): _floor,
    id(lanes.root): _root,
    id(lanes.size): _size,
    id(lanes.gather): _gather,
    id(lanes.gather_rows): _gather_row,
    id(lanes.spread): _itself,
}


def in_python(kernel: Callable[..., Any]) -> Any:
    """The function of a kernel in which lanes are single numbers and nothing is compiled."""
    function: Any = _ONE_NUMBER.get(id(kernel)) or kernel.py_func  # type: ignore[attr-defined]

    def value_of(value: Any) -> Any:
        return in_python(value) if hasattr(value, "py_func") or id(value) in _ONE_NUMBER else value

    read = {i.argval for i in dis.get_instructions(function.__code__) if i.opname == "LOAD_GLOBAL"}
    names = {name: value_of(function.__globals__[name]) for name in read if name in function.__globals__}
    cells = tuple(CellType(value_of(cell.cell_contents)) for cell in function.__closure__ or ())
    return FunctionType(
        function.__code__, {**function.__globals__, **names}, function.__name__, function.__defaults__, cells or None
    )
