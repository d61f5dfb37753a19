"""Rows of a table, a row a lane: four numbers that lie side by side, read at once (`kernels.emit.rows`)."""

from __future__ import annotations

from typing import Any

from kernels.intrinsic import Intrinsic

ROW = 4
gather_rows: Any = Intrinsic("rows", "gather_rows")
