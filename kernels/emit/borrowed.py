"""Arrays without a reference count: what a kernel's caller owns is lent to the functions that the kernel calls.

numba counts the references to an array whenever a function takes it or a view of it is made, and each count is an
atomic operation: where a kernel calls small functions millions of times they are a fifth of its time.
"""

# numba's inner parts carry no types
# mypy: disable-error-code="no-untyped-call"
from __future__ import annotations

from typing import Any

from numba import extending
from numba.core import cgutils

intrinsic: Any = extending.intrinsic


@intrinsic
def borrowed(typing_context: Any, array: Any) -> Any:
    """``array`` without a reference count; its owner must outlive it, as the arguments of a kernel do."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lent = context.make_array(sig.args[0])(context, builder, args[0])
        lent.meminfo = cgutils.get_null_value(lent.meminfo.type)
        lent.parent = cgutils.get_null_value(lent.parent.type)
        return lent._getvalue()

    return array(array), emit
