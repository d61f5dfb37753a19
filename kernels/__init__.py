"""Compiled kernels: the decorator that compiles them, and the folder that keeps their machine code.

numba compiles. Code that was stored runs without it: of numba only the memory of arrays is loaded, see
`kernels.machine_code`. Whoever takes `njit` has the C library keep the memory of arrays that are gone.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numba import njit  # the same types

__all__ = ["njit"]

BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that say, before numpy is imported, how many threads linear algebra has."""
LARGEST_BYTES = 1 << 23  # of a stored block: the results and the work arrays of a diagram, a piece of a recording


def __getattr__(name: str) -> Any:
    """`njit` when it is first asked for: commands that only print help import no numpy for `kernels.errors`."""
    if name != "njit":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from kernels.store import njit as compiled

    keep_freed_blocks()
    globals()["njit"] = compiled
    return compiled


def keep_freed_blocks() -> None:
    """Have the C library keep freed blocks to `LARGEST_BYTES`: frees one that was never written to, so is no memory.

    The C library of Linux gives a large block back to the system as soon as it is freed, and the next array of that
    size is made of new pages, of which each costs the processor microseconds when it is first written to. A block that
    was freed once is a measure to it: from then on it keeps freed blocks that are no larger, and twice as much in all.
    Where the C library has rules of its own (Windows, macOS, ``MALLOC_`` variables that are set), nothing changes.

    References
    ----------
    mallopt(3), M_MMAP_THRESHOLD and M_TRIM_THRESHOLD: both move with the largest block freed.
    """
    import numpy as np

    np.empty(LARGEST_BYTES, dtype=np.uint8)
