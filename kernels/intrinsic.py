"""Names of functions that write machine code themselves (numba's intrinsics): only a compiler needs more of them."""

from __future__ import annotations


class Intrinsic:
    """The intrinsic ``name`` of ``kernels.emit.<module>``, which is imported when a kernel is compiled."""

    def __init__(self, module: str, name: str) -> None:
        self.module, self.name = f"kernels.emit.{module}", name
