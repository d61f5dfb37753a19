"""Compiled kernels: the decorator that compiles them, and the folder that keeps their machine code.

numba compiles. Code that was kept runs without it: of numba only the memory of arrays is loaded, see
`kernels.machine_code`. Whoever imports this has the C library keep the memory of arrays that are gone, see
`kernels.memory`.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numba import njit  # the same types
else:
    from kernels.kernel import njit
    from kernels.memory import keep_freed_blocks

    keep_freed_blocks()

__all__ = ["njit"]
