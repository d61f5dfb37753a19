"""The one way this room compiles a kernel; sine and cosine that every kernel shares; the records that they take.

Kernels are compiled by numba and cached on disk, with IEEE division (`error_model="numpy"`: a division by zero gives
inf, not a branch), so that the compiler can vectorise. Of `fastmath` only the fused multiply-add is allowed, never a
reordering, because the rounding bounds rely on the order. Records are named tuples, because numba passes them as it
passes their fields.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

from kernels import njit
from kernels.arrays import Floats
from kernels.lanes import floor, nearest, select

Number = Any
"""One double, or many in lanes (`kernels.lanes`)."""
_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile ``function`` at its first call (a decorator that keeps its type)."""
    return cast(_F, njit(error_model="numpy", fastmath={"contract"})(function))


def inlined(function: _F) -> _F:
    """Compile ``function`` into every kernel that calls it."""
    return cast(_F, njit(error_model="numpy", fastmath={"contract"}, forceinline=True)(function))


# pi/2 = HALF_PI_1 + HALF_PI_2 + HALF_PI_3, the first two of 33 bits: k times them is exact for |k| < 2^20
HALF_PI_1 = float.fromhex("0x1.921fb54400000p+0")
HALF_PI_2 = float.fromhex("0x1.0b4611a600000p-34")
HALF_PI_3 = float.fromhex("0x1.3198a2e037073p-69")
TWO_OVER_PI = 2.0 / math.pi
S3, S5, S7, S9, S11, S13, S15, S17 = ((-1) ** m / math.factorial(2 * m + 1) for m in range(1, 9))
C4, C6, C8, C10, C12, C14, C16, C18 = ((-1) ** m / math.factorial(2 * m) for m in range(2, 10))


@inlined
def sine_series(y: Number) -> Number:
    """``(sin x - x) / x^3`` by its Taylor series in ``y = x^2``, to rounding for ``|x| < 1``."""
    z = y * y
    return (S3 + y * S5) + z * (S7 + y * S9) + z * z * ((S11 + y * S13) + z * (S15 + y * S17))


@inlined
def cosine_series(y: Number) -> Number:
    """``(cos x - 1 + x^2 / 2) / x^4``, as `sine_series`."""
    z = y * y
    return (C4 + y * C6) + z * (C8 + y * C10) + z * z * ((C12 + y * C14) + z * (C16 + y * C18))


@inlined
def sincos(x: Number) -> tuple[Number, Number]:
    """``sin x`` and ``cos x`` for ``|x| < 1e6``, each to 1.2e-16: Taylor series after taking out multiples of pi/2.

    Without a branch or a call, so that it serves one number and many in lanes (`kernels.lanes`) alike.
    """
    k = nearest(x * TWO_OVER_PI)
    r = ((x - k * HALF_PI_1) - k * HALF_PI_2) - k * HALF_PI_3
    y = r * r
    z = y * y
    sine = r + r * y * sine_series(y)
    cosine = 1.0 - 0.5 * y + z * ((C4 + y * C6) + z * (C8 + y * C10) + z * z * ((C12 + y * C14) + z * C16))
    quarter = k - 4.0 * floor(0.25 * k)
    odd = (quarter == 1.0) | (quarter == 3.0)
    a = select(odd, cosine, sine)
    b = select(odd, sine, cosine)
    return select(quarter >= 2.0, -a, a), select((quarter == 1.0) | (quarter == 2.0), -b, b)


class Segment(NamedTuple):
    """The start of a segment of a flight: ``phi0, s(phi0), s'(phi0), h''(0), v0, h0`` and the steady pull."""

    phase: float
    s: float
    slope: float
    acceleration: float
    speed: float
    height: float
    pull: float


class FrictionRestitution(NamedTuple):
    """Coulomb friction in units of the weight, up and down, and restitution ``e0 - e1 v``, v in units of g/w."""

    mu_up: float = 0.0
    mu_down: float = 0.0
    e0: float = 0.0
    e1: float = 0.0


Tangent = tuple[float, float, float, float]
"""Derivatives of a flight: of its landing's phase by phase and speed of its take-off, then of its rebound's speed."""


class EdgeTables(NamedTuple):
    """Window edges (`model.flight.branches.fill_edges`) at the pulls going up and going down, and their windows."""

    up: Floats
    n_up: int
    down: Floats
    n_down: int
