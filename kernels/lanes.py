"""Numbers in lanes: `WIDTH` doubles that a compiled kernel computes with as with one, by the processor's vector units.

A value in lanes adds, multiplies and compares lane by lane; a comparison gives a mask, and `select` takes the place of
a branch. The functions below take single numbers as well, so that a formula is written once for the lanes of a
processor, and for one number. Nothing is reordered; only the fused
multiply-add is allowed, as in every kernel. What each does stands at its code, in `kernels.emit.lanes`.
"""

from __future__ import annotations

from typing import Any

from kernels.intrinsic import Intrinsic

WIDTH = 16
"""Two registers of 512 bits, four of 256: one alone would wait for the latency of each operation."""
ROW = 4
"""Numbers side by side in a table that `gather_rows` reads at once."""

any_of: Any = Intrinsic("lanes", "any_of")
count: Any = Intrinsic("lanes", "count")
floor: Any = Intrinsic("lanes", "floor")
gather: Any = Intrinsic("lanes", "gather")
gather_rows: Any = Intrinsic("lanes", "gather_rows")
load: Any = Intrinsic("lanes", "load")
nearest: Any = Intrinsic("lanes", "nearest")
root: Any = Intrinsic("lanes", "root")
select: Any = Intrinsic("lanes", "select")
size: Any = Intrinsic("lanes", "size")
spread: Any = Intrinsic("lanes", "spread")
store: Any = Intrinsic("lanes", "store")
