"""Arrays without a reference count, see `kernels.emit.borrowed`."""

from __future__ import annotations

from typing import Any

from kernels.intrinsic import Intrinsic

borrowed: Any = Intrinsic("borrowed", "borrowed")
