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

from kernels.lanes import WIDTH

intrinsic: Any = extending.intrinsic
_DOUBLES = ir.VectorType(ir.DoubleType(), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)
_INTEGERS = ir.VectorType(ir.IntType(64), WIDTH)
_FUSED = ("contract",)


class Lanes(types.Type):
    """The type of `WIDTH` doubles."""

    def __init__(self) -> None:
        super().__init__(name=f"lanes{WIDTH}")


class Mask(types.Type):
    """The type of `WIDTH` truth values."""

    def __init__(self) -> None:
        super().__init__(name=f"mask{WIDTH}")


lanes_type, mask_type = Lanes(), Mask()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _DOUBLES)


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _BITS)


def _spread(builder: Any, context: Any, value: Any, given: Any) -> Any:
    """A value of the type ``given`` in every lane."""
    if isinstance(given, Lanes):
        return value
    number = context.cast(builder, value, given, types.float64)
    return _splat(builder, number, _DOUBLES)


def _splat(builder: Any, number: Any, vector: Any) -> Any:
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros)


def _number(given: Any) -> bool:
    return isinstance(given, types.Float | types.Integer)


def _binary(function: Any, emit: Callable[[Any, Any, Any], Any], result: Any) -> None:
    """Teach numba an operator of two lanes, or of lanes and a number."""

    @infer_global(function)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            fits = all(isinstance(a, Lanes) or _number(a) for a in args) and any(isinstance(a, Lanes) for a in args)
            return signature(result, *args) if fits and len(args) == 2 else None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_spread(builder, context, value, given) for value, given in zip(args, sig.args, strict=True))
        return emit(builder, a, b)

    lower_builtin(function, Lanes, Lanes)(lower)
    for number in (types.Float, types.Integer):
        lower_builtin(function, Lanes, number)(lower)
        lower_builtin(function, number, Lanes)(lower)


for _function, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _binary(_function, lambda b, x, y, name=_name: getattr(b, name)(x, y, flags=_FUSED), lanes_type)
for _function, _name in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
):
    _binary(_function, lambda b, x, y, name=_name: b.fcmp_ordered(name, x, y), mask_type)


def _mask_operator(function: Any, name: str) -> None:
    @infer_global(function)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            return signature(mask_type, *args) if args == (mask_type, mask_type) else None

    @lower_builtin(function, Mask, Mask)
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, name)(*args)


_mask_operator(operator.and_, "and_")
_mask_operator(operator.or_, "or_")


@infer_global(operator.invert)
class _InvertTyping(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(mask_type, *args) if args == (mask_type,) else None


@lower_builtin(operator.invert, Mask)
def _invert(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.not_(args[0])


@infer_global(operator.neg)
class _NegTyping(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(lanes_type, *args) if args == (lanes_type,) else None


@lower_builtin(operator.neg, Lanes)
def _neg(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


@intrinsic
def select(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where ``mask``, else ``b``; both are computed."""
    result = lanes_type if isinstance(mask, Mask) else types.float64

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if result is lanes_type:
            a, b = (_spread(builder, context, args[i], sig.args[i]) for i in (1, 2))
        else:
            a, b = (context.cast(builder, args[i], sig.args[i], types.float64) for i in (1, 2))
        return builder.select(args[0], a, b)

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
    if not isinstance(mask, Mask):
        return None
    bits = ir.IntType(WIDTH)

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        ones = builder.ctpop(builder.bitcast(args[0], bits))
        return builder.zext(ones, ir.IntType(64))

    return types.int64(mask), emit


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


@intrinsic
def load(typing_context: Any, array: Any, start: Any) -> Any:
    """``array[start : start + WIDTH]`` of a contiguous array of doubles."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        index = context.cast(builder, args[1], sig.args[1], types.intp)
        pointer = _pointer(context, builder, sig.args[0], args[0], index)
        return builder.load(builder.bitcast(pointer, _DOUBLES.as_pointer()), align=8)

    return lanes_type(array, start), emit


@intrinsic
def store(typing_context: Any, array: Any, start: Any, value: Any) -> Any:
    """Write ``value`` to ``array[start : start + WIDTH]``."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        index = context.cast(builder, args[1], sig.args[1], types.intp)
        pointer = _pointer(context, builder, sig.args[0], args[0], index)
        value = _spread(builder, context, args[2], sig.args[2])
        builder.store(value, builder.bitcast(pointer, _DOUBLES.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(array, start, value), emit


@intrinsic
def spread(typing_context: Any, number: Any) -> Any:
    """One number in every lane."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, context, args[0], sig.args[0])

    return lanes_type(number), emit


@intrinsic
def gather(typing_context: Any, array: Any, index: Any) -> Any:
    """``array[index]`` lane by lane, of a contiguous array of doubles; ``index`` holds whole numbers."""

    lanes = isinstance(index, Lanes)

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = context.make_array(sig.args[0])(context, builder, args[0]).data
        if not lanes:
            return builder.load(builder.gep(base, [builder.fptosi(args[1], ir.IntType(64))]))
        whole = builder.fptosi(args[1], _INTEGERS)
        found = ir.Constant(_DOUBLES, ir.Undefined)
        for k in range(WIDTH):
            place = ir.Constant(ir.IntType(32), k)
            found = builder.insert_element(
                found, builder.load(builder.gep(base, [builder.extract_element(whole, place)])), place
            )
        return found

    return (lanes_type if lanes else types.float64)(array, index), emit
