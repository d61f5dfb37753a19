"""Records that the compiled kernels take: a segment of a flight, the law of friction and restitution, tables of edges.

Named tuples, because numba passes them as it passes their fields.
"""

from __future__ import annotations

from typing import NamedTuple

from kernels.arrays import Floats


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
