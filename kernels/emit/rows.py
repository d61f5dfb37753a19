"""Rows of a table, a row a lane: four numbers that lie side by side, read at once and turned into four lanes.

A gather (`kernels.lanes.gather`) reads one number for each lane; a row of four comes in one load, and a few shuffles
turn the rows of eight lanes into columns.
"""

# numba's inner parts carry no types
# mypy: disable-error-code="no-untyped-call,misc"
from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import extending
from numba.core import types

from kernels.emit.lanes import Lanes, lanes_type
from kernels.lanes import WIDTH
from kernels.rows import ROW

intrinsic: Any = extending.intrinsic
_ROW = ir.VectorType(ir.DoubleType(), ROW)
_INTEGERS = ir.VectorType(ir.IntType(64), WIDTH)
# of the rows a and b of a pair beside those of another: columns 0 and 1, columns 2 and 3; then either half of both
_FIRST, _SECOND = (0, 4, 8, 12, 1, 5, 9, 13), (2, 6, 10, 14, 3, 7, 11, 15)
_LOW, _HIGH = (0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)


def _mask(places: Any) -> Any:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(places)), list(places))


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """The four columns of eight rows."""
    pairs = [builder.shuffle_vector(rows[i], rows[i + 1], _mask(range(8))) for i in range(0, 8, 2)]
    columns = []
    for order in (_FIRST, _SECOND):
        left = builder.shuffle_vector(pairs[0], pairs[1], _mask(order))
        right = builder.shuffle_vector(pairs[2], pairs[3], _mask(order))
        columns += [builder.shuffle_vector(left, right, _mask(half)) for half in (_LOW, _HIGH)]
    return columns


@intrinsic
def gather_rows(typing_context: Any, array: Any, index: Any) -> Any:
    """``array[index : index + ROW]`` lane by lane, as a tuple of `ROW`; ``index`` holds whole numbers."""
    if not isinstance(index, Lanes):
        return None
    result = types.UniTuple(lanes_type, ROW)

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = context.make_array(sig.args[0])(context, builder, args[0]).data
        whole = builder.fptosi(args[1], _INTEGERS)
        rows = []
        for k in range(WIDTH):
            start = builder.gep(base, [builder.extract_element(whole, ir.Constant(ir.IntType(32), k))])
            rows.append(builder.load(builder.bitcast(start, _ROW.as_pointer()), align=8))
        halves = zip(*(_columns(builder, rows[i : i + 8]) for i in range(0, WIDTH, 8)), strict=True)
        both = _mask(range(WIDTH))
        return context.make_tuple(builder, result, [builder.shuffle_vector(a, b, both) for a, b in halves])

    return result(array, index), emit
