"""Parameters and arrays as the integrator's kernels take them."""

from __future__ import annotations

import functools
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Complexes, Floats
from model.effects.registry import null_row, registry

_T = TypeVar("_T", bound=np.generic)


@functools.cache
def columns_of(hook: str) -> NDArray[np.intp]:
    """Places in the row of all parameters of the effects that define ``hook``."""
    return np.array(
        [
            e.offset + i
            for e in registry()
            if hook in e.hooks
            for i, q in enumerate(e.effect.parameters)
            if not q.is_shape or q.name == "of"
        ],
        dtype=np.intp,
    )


@functools.cache
def _nothing(hook: str) -> Floats:
    """The null values of `columns_of`."""
    return null_row(0.0)[columns_of(hook)]


def active(rows: Floats, hook: str) -> bool:
    """Whether any effect with ``hook`` acts in ``rows`` (..., P + 1)."""
    return bool((rows[..., columns_of(hook)] != _nothing(hook)).any())


def for_kernel(values: NDArray[_T]) -> NDArray[_T]:
    """An array as the kernels take it, contiguous and writable: numba compiles each layout, and each right, anew."""
    if values.flags.c_contiguous and values.flags.writeable:
        return values
    return np.require(values, requirements=["C", "W"])


def tones_for_kernel(omega_radps: Floats, acceleration_mps2: Complexes) -> Floats:
    """Tones (..., k) as the kernels take them, (..., k, 3)."""
    out = np.empty((*acceleration_mps2.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = omega_radps, acceleration_mps2.real, acceleration_mps2.imag
    return out
