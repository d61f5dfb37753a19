"""The rough, bouncing ball: Coulomb friction on the rod and restitution at the plate, flown exactly; dimensionless.

The rule kept here: friction and restitution are parameters of one kernel (`model.flight.friction`), all of whose
motions have closed forms, so that no step is taken between events. Friction opposes the motion relative to the plate
(static equals kinetic); the ball leaves when ``-a_p > g (1 + mu_up)`` and hangs on the rod, in mid-air, while
``-mu_down g <= -(g + a_p) <= mu_up g``. It rebounds at ``e = e0 - e1 v`` of its impact speed ``v``.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.flight import branches, friction, ideal, segment
from model.flight.first_landing import turning_points
from model.series import batched_friction
from model.tones import STANDARD_GRAVITY_MPS2, Forcing

Floats = NDArray[np.float64]


class RoughFlag(enum.IntFlag):
    """What is special about a flight of the rough ball."""

    RESET = ideal.RESET
    """It started from rest, at a threshold."""
    UNDECIDED = segment.UNDECIDED
    """A graze, or a standstill just above the plate, closer than double precision can tell."""
    RESTS = ideal.RESTS
    """There was none: the ball does not leave, or hangs on the rod for ever."""
    HUNG = friction.HUNG
    """The ball hung on the rod in mid-air."""
    CHATTERED = friction.CHATTERED
    """Its landing began ever smaller bounces, summed to their end: the ball came to rest."""


@dataclass(frozen=True)
class FrictionRestitution:
    """Friction and restitution, dimensionless.

    Parameters
    ----------
    mu_up, mu_down : float
        Coulomb friction in units of the weight, going up and going down relative to the plate; ``mu_down < 1``, or
        the ball would stay on the rod of a still plate.
    e0, e1 : float
        Restitution ``e0 - e1 v``, v the impact speed relative to the plate in units of g/w; kept within [0, 1].

    Raises
    ------
    ValueError
        If a value is not finite or out of range.
    """

    mu_up: float = 0.0
    mu_down: float = 0.0
    e0: float = 0.0
    e1: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what has no meaning."""
        if not all(map(math.isfinite, (self.mu_up, self.mu_down, self.e0, self.e1))):
            raise ValueError(f"friction and restitution must be finite, not {self}")
        if not (self.mu_up >= 0.0 and 0.0 <= self.mu_down < 1.0):
            raise ValueError(f"friction must satisfy 0 <= mu_up and 0 <= mu_down < 1, not {self.mu_up}, {self.mu_down}")
        if not 0.0 <= self.e0 <= 1.0:
            raise ValueError(f"restitution at speed zero must be within [0, 1], not {self.e0}")

    @classmethod
    def from_si(
        cls,
        *,
        mu_up: float = 0.0,
        mu_down: float = 0.0,
        e0: float = 0.0,
        e1_s_per_m: float = 0.0,
        omega_radps: float,
        g_mps2: float = STANDARD_GRAVITY_MPS2,
    ) -> FrictionRestitution:
        """The same with ``e1`` in s/m: the unit of speed is ``g/w``."""
        return cls(mu_up, mu_down, e0, e1_s_per_m * g_mps2 / omega_radps)

    @property
    def packed(self) -> tuple[float, float, float, float]:
        """``mu_up, mu_down, e0, e1``: what the compiled kernels take."""
        return float(self.mu_up), float(self.mu_down), float(self.e0), float(self.e1)


@dataclass(frozen=True)
class RoughOrbit:
    """Successive flights of the rough ball, arrays of equal shape.

    ``tau`` (hanging included), ``takeoff_phase`` in [0, 2 pi), ``impact_speed`` (units g/w), ``rest_tau`` (from landing
    to rest by chatter, NaN where the landing does not chatter), ``flag`` (`RoughFlag` bits).
    """

    tau: Floats
    takeoff_phase: Floats
    impact_speed: Floats
    rest_tau: Floats
    flag: NDArray[np.int8]


def run_rough_orbit(
    forcing: Forcing,
    gamma: float,
    rough: FrictionRestitution,
    n_transient: int,
    n_keep: int,
    phi0: float = 0.0,
    v0: float = 0.0,
) -> RoughOrbit:
    """`run_rough_diagram` at one gamma: arrays of shape ``(n_keep,)``."""
    batch = run_rough_diagram(forcing, np.array([gamma]), rough, n_transient, n_keep, phi0, v0)
    return RoughOrbit(batch.tau[0], batch.takeoff_phase[0], batch.impact_speed[0], batch.rest_tau[0], batch.flag[0])


def run_rough_diagram(
    forcing: Forcing,
    gammas: ArrayLike,
    rough: FrictionRestitution,
    n_transient: int,
    n_keep: int,
    phi0: float = 0.0,
    v0: float = 0.0,
) -> RoughOrbit:
    """``n_keep`` flights after ``n_transient`` at each gamma, begun on the plate at ``phi0`` with speed ``v0`` off it.

    Every bounce is a flight until the chatter's tail is summed. Arrays have the shape ``(len(gammas), n_keep)``.

    Raises
    ------
    ValueError
        If a gamma is negative or not finite, a count or ``v0`` negative, or the forcing not periodic.
    """
    grid = np.ascontiguousarray(gammas, dtype=np.float64)
    if not (np.all(np.isfinite(grid)) and np.all(grid >= 0.0)):
        raise ValueError(f"gamma must be finite and not negative, not {gammas!r}")
    if n_transient < 0 or n_keep < 0:
        raise ValueError(f"flight counts must not be negative, not {n_transient} and {n_keep}")
    if not (math.isfinite(phi0) and math.isfinite(v0) and v0 >= 0.0):
        raise ValueError(f"phi0 must be finite and v0 finite and not negative, not {phi0} and {v0}")
    shape = (grid.size, n_keep)
    out, flags = np.empty((4, *shape)), np.empty(shape, dtype=np.int8)
    start = (branches.fold(phi0, 0.0), float(v0))
    batched_friction.rough_lockstep_diagram(
        forcing.tones, turning_points(forcing), grid, rough.packed, start, n_transient, out, flags
    )
    return RoughOrbit(out[0], out[1], out[2], out[3], flags)
