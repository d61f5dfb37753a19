"""The one way this room compiles a kernel: numba, cached on disk, IEEE division, types kept for the type checker.

The rule kept here: `error_model="numpy"` everywhere (a division by zero gives inf, not a branch), which lets the
compiler vectorise, and no `fastmath`, which would let it reorder what the rounding bounds rely on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.int8]
_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile ``function`` at its first call (a decorator)."""
    return cast(_F, njit(cache=True, error_model="numpy")(function))
