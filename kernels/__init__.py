"""Compiled kernels: the decorator that compiles them, and the folder that keeps their machine code.

numba compiles. Code that was kept runs without it: of numba only the memory of arrays is loaded, see
`kernels.machine_code`. Whoever takes `njit` has the C library keep the memory of arrays that are gone, see
`kernels.memory`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numba import njit  # the same types

__all__ = ["njit"]


def __getattr__(name: str) -> Any:
    """`njit` when it is first asked for: commands that only print help import no numpy for `kernels.errors`."""
    if name != "njit":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from kernels.kernel import njit as compiled
    from kernels.memory import keep_freed_blocks

    keep_freed_blocks()
    globals()["njit"] = compiled
    return compiled
