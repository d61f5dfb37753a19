"""Numbers in lanes: `WIDTH` doubles that a compiled kernel computes with as with one, by the processor's vector units.

A value in lanes adds, multiplies and compares lane by lane; a comparison gives a mask, and `select` takes the place of
a branch. The functions below take single numbers as well, so that a formula is written once for the lanes of a
processor, and for one number. Nothing is reordered; only the fused
multiply-add is allowed, as in every kernel. What each does stands at its code, in `kernels.emit.lanes`.
"""

from __future__ import annotations

from typing import Any


class Intrinsic:
    """A function that writes machine code itself, ``name`` of `kernels.emit.lanes`: imported when one is compiled."""

    def __init__(self, name: str) -> None:
        self.name = name


WIDTH = 16
"""Two registers of 512 bits, four of 256: with one, each operation would wait for the latency of the one before."""
ROW = 4
"""Numbers side by side in a table that `gather_rows` reads at once."""

any_of: Any = Intrinsic("any_of")
count: Any = Intrinsic("count")
floor: Any = Intrinsic("floor")
gather: Any = Intrinsic("gather")
gather_rows: Any = Intrinsic("gather_rows")
load: Any = Intrinsic("load")
nearest: Any = Intrinsic("nearest")
root: Any = Intrinsic("root")
select: Any = Intrinsic("select")
size: Any = Intrinsic("size")
spread: Any = Intrinsic("spread")
store: Any = Intrinsic("store")
