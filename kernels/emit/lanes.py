"""What the functions of `kernels.lanes` do, as LLVM's code: types of lanes and masks, operators and intrinsics."""

# numba's inner parts carry no types
# mypy: disable-error-code="no-untyped-call,misc"
from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import extending
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model

from kernels.lanes import ROW, WIDTH

intrinsic: Any = extending.intrinsic
_DOUBLES = ir.VectorType(ir.DoubleType(), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)
_INTEGERS = ir.VectorType(ir.IntType(64), WIDTH)


class Lanes(types.Type):
    """The type of `WIDTH` doubles."""

    def __init__(self) -> None:
        super().__init__(name=f"lanes{WIDTH}")


class Mask(types.Type):
    """The type of `WIDTH` truth values."""

    def __init__(self) -> None:
        super().__init__(name=f"mask{WIDTH}")


lanes_type, mask_type = Lanes(), Mask()


def _held_in(vector: Any) -> Any:
    """How numba holds a type: as a vector of LLVM's."""

    class Model(models.PrimitiveModel):
        def __init__(self, manager: Any, fe_type: Any) -> None:
            super().__init__(manager, fe_type, vector)

    return Model


register_model(Lanes)(_held_in(_DOUBLES))
register_model(Mask)(_held_in(_BITS))


def _place(k: int) -> Any:
    return ir.Constant(ir.IntType(32), k)


def _order(places: Any) -> Any:
    """A mask of LLVM's shuffles."""
    return ir.Constant(ir.VectorType(ir.IntType(32), len(places)), list(places))


def _spread(builder: Any, context: Any, value: Any, given: Any) -> Any:
    """A value of the type ``given`` in every lane."""
    if isinstance(given, Lanes | Mask):
        return value
    number = context.cast(builder, value, given, types.float64)
    nothing = ir.Constant(_DOUBLES, ir.Undefined)
    return builder.shuffle_vector(builder.insert_element(nothing, number, _place(0)), nothing, _order([0] * WIDTH))


def _teach(function: Any, kinds: list[tuple[Any, ...]], result: Any, emit: Callable[..., Any]) -> None:
    """Teach numba an operator for arguments of each of ``kinds``; numbers are spread."""

    @infer_global(function)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            fits = any(len(args) == len(kind) and all(map(isinstance, args, kind)) for kind in kinds)
            return signature(result, *args) if fits else None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        given = zip(args, sig.args, strict=True)
        return emit(builder, *(_spread(builder, context, value, typed) for value, typed in given))

    for kind in kinds:
        lower_builtin(function, *kind)(lower)


_PAIRS: list[tuple[Any, ...]] = [(Lanes, Lanes)]
for _number in (types.Float, types.Integer):
    _PAIRS += [(Lanes, _number), (_number, Lanes)]
for _name in ("add", "sub", "mul", "div"):
    _function = operator.truediv if _name == "div" else getattr(operator, _name)
    _teach(_function, _PAIRS, lanes_type, lambda b, x, y, name=_name: getattr(b, f"f{name}")(x, y, flags=("contract",)))
for _name in ("lt", "le", "gt", "ge", "eq"):
    _sign = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "=="}[_name]
    _teach(getattr(operator, _name), _PAIRS, mask_type, lambda b, x, y, sign=_sign: b.fcmp_ordered(sign, x, y))
_teach(operator.and_, [(Mask, Mask)], mask_type, lambda b, x, y: b.and_(x, y))
_teach(operator.or_, [(Mask, Mask)], mask_type, lambda b, x, y: b.or_(x, y))
_teach(operator.invert, [(Mask,)], mask_type, lambda b, x: b.not_(x))
_teach(operator.neg, [(Lanes,)], lanes_type, lambda b, x: b.fneg(x))


@intrinsic
def select(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where ``mask``, else ``b``, of tuples item by item; both are computed."""
    many = isinstance(a, types.BaseTuple)
    item = lanes_type if isinstance(mask, Mask) else types.float64
    named = isinstance(a, types.NamedUniTuple) and a.dtype == item  # stays one
    result: Any = (a if named else types.UniTuple(item, len(a))) if many else item

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        def chosen(x: Any, x_type: Any, y: Any, y_type: Any) -> Any:
            if item is lanes_type:
                x, y = _spread(builder, context, x, x_type), _spread(builder, context, y, y_type)
            else:
                x, y = context.cast(builder, x, x_type, item), context.cast(builder, y, y_type, item)
            return builder.select(args[0], x, y)

        if not many:
            return chosen(args[1], sig.args[1], args[2], sig.args[2])
        left, right = (cgutils.unpack_tuple(builder, args[i], len(sig.args[i])) for i in (1, 2))
        items = zip(left, sig.args[1], right, sig.args[2], strict=True)
        return context.make_tuple(builder, result, [chosen(*each) for each in items])

    return result(mask, a, b), emit


def _unary(name: str, doc: str) -> Any:
    """The function of the processor named ``name`` by LLVM, for lanes and for one number."""

    @intrinsic
    def function(typing_context: Any, x: Any) -> Any:
        lanes = isinstance(x, Lanes)

        def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind, suffix = (_DOUBLES, f"v{WIDTH}f64") if lanes else (ir.DoubleType(), "f64")
            callee = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(kind, [kind]), f"llvm.{name}.{suffix}"
            )
            return builder.call(
                callee, [args[0] if lanes else context.cast(builder, args[0], sig.args[0], types.float64)]
            )

        return (lanes_type if lanes else types.float64)(x), emit

    function.__doc__ = doc
    return function


floor = _unary("floor", "The next whole number below.")
nearest = _unary("rint", "The nearest whole number.")
root = _unary("sqrt", "The square root.")
size = _unary("fabs", "The absolute value.")


@intrinsic
def any_of(typing_context: Any, mask: Any) -> Any:
    """Whether any lane is true."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if not isinstance(mask, Mask):
            return args[0]
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))

    return types.boolean(mask), emit


@intrinsic
def count(typing_context: Any, mask: Any) -> Any:
    """How many lanes are true."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        ones = builder.ctpop(builder.bitcast(args[0], ir.IntType(WIDTH)))
        return builder.zext(ones, ir.IntType(64))

    return (types.int64(mask), emit) if isinstance(mask, Mask) else None


def _pointer(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Where the lanes of an array begin, of its first and second argument."""
    index = context.cast(builder, args[1], sig.args[1], types.intp)
    data = context.make_array(sig.args[0])(context, builder, args[0]).data
    return builder.bitcast(builder.gep(data, [index]), _DOUBLES.as_pointer())


@intrinsic
def load(typing_context: Any, array: Any, start: Any) -> Any:
    """``array[start : start + WIDTH]`` of a contiguous array of doubles."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_pointer(context, builder, sig, args), align=8)

    return lanes_type(array, start), emit


@intrinsic
def store(typing_context: Any, array: Any, start: Any, value: Any) -> Any:
    """Write ``value`` to ``array[start : start + WIDTH]``."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = _spread(builder, context, args[2], sig.args[2])
        builder.store(value, _pointer(context, builder, sig, args), align=8)
        return context.get_dummy_value()

    return types.void(array, start, value), emit


@intrinsic
def spread(typing_context: Any, number: Any) -> Any:
    """One number in every lane."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, context, args[0], sig.args[0])

    return lanes_type(number), emit


def _places(context: Any, builder: Any, sig: Any, args: Any) -> list[Any]:
    """Where each lane's number lies in an array, by an index of whole numbers."""
    base = context.make_array(sig.args[0])(context, builder, args[0]).data
    whole = builder.fptosi(args[1], _INTEGERS)
    return [builder.gep(base, [builder.extract_element(whole, _place(k))]) for k in range(WIDTH)]


@intrinsic
def gather(typing_context: Any, array: Any, index: Any) -> Any:
    """``array[index]`` lane by lane, of a contiguous array of doubles; ``index`` holds whole numbers."""

    lanes = isinstance(index, Lanes)

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if not lanes:
            base = context.make_array(sig.args[0])(context, builder, args[0]).data
            return builder.load(builder.gep(base, [builder.fptosi(args[1], ir.IntType(64))]))
        found = ir.Constant(_DOUBLES, ir.Undefined)
        for k, place in enumerate(_places(context, builder, sig, args)):
            found = builder.insert_element(found, builder.load(place), _place(k))
        return found

    return (lanes_type if lanes else types.float64)(array, index), emit


# shuffles of eight rows into four columns: of two rows each, columns 0 and 1, columns 2 and 3; then either half of both
_FIRST, _SECOND = (0, 4, 8, 12, 1, 5, 9, 13), (2, 6, 10, 14, 3, 7, 11, 15)
_LOW, _HIGH = (0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """The four columns of eight rows."""
    pairs = [builder.shuffle_vector(rows[i], rows[i + 1], _order(range(8))) for i in range(0, 8, 2)]
    columns = []
    for order in (_FIRST, _SECOND):
        left = builder.shuffle_vector(pairs[0], pairs[1], _order(order))
        right = builder.shuffle_vector(pairs[2], pairs[3], _order(order))
        columns += [builder.shuffle_vector(left, right, _order(half)) for half in (_LOW, _HIGH)]
    return columns


@intrinsic
def gather_rows(typing_context: Any, array: Any, index: Any) -> Any:
    """``array[index : index + ROW]`` lane by lane, as a tuple of `ROW`; ``index`` holds whole numbers.

    A row comes in one load, and a few shuffles turn the rows of all lanes into columns.
    """
    result = types.UniTuple(lanes_type, ROW)
    row = ir.VectorType(ir.DoubleType(), ROW).as_pointer()

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        places = _places(context, builder, sig, args)
        rows = [builder.load(builder.bitcast(place, row), align=8) for place in places]
        halves = zip(*(_columns(builder, rows[i : i + 8]) for i in range(0, WIDTH, 8)), strict=True)
        both = _order(range(WIDTH))
        return context.make_tuple(builder, result, [builder.shuffle_vector(a, b, both) for a, b in halves])

    return (result(array, index), emit) if isinstance(index, Lanes) else None
