"""Memory that arrays gave back, kept for those that come after them.

The C library of Linux gives a large block back to the system as soon as it is freed, and the next array of that size
is made of new pages, of which each costs the processor microseconds when it is first written to. A block that was
freed once is a measure to it: from then on it keeps freed blocks that are no larger, and twice as much in all.

References
----------
mallopt(3), M_MMAP_THRESHOLD and M_TRIM_THRESHOLD: both move with the largest block freed.
"""

from __future__ import annotations

import numpy as np

LARGEST_BYTES = 1 << 23  # of a block that is kept: the results and the work arrays of a diagram, a piece of a recording


def keep_freed_blocks() -> None:
    """Have the C library keep freed blocks to `LARGEST_BYTES`: frees one that was never written to, so is no memory.

    Where the C library has rules of its own (Windows, macOS, ``MALLOC_`` variables that are set), nothing changes.
    """
    np.empty(LARGEST_BYTES, dtype=np.uint8)
