"""Compiled kernels: the decorator that compiles them, and the folder that keeps their machine code."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numba import njit  # the same types
else:
    from kernels.cache import njit

__all__ = ["njit"]
