"""Compiled kernels: the decorator that compiles them, and the folder that keeps their machine code."""

from kernels.cache import njit

__all__ = ["njit"]
