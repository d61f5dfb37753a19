"""The ideal ball on a plate of tones: take-off phases and one flight; dimensionless (see `model.tones`).

The readable face of the compiled kernels (`model.flight.branches`, `model.flight.ideal`), with checked arguments.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from kernels.arrays import Floats
from model.flight import branches, ideal, segment
from model.flight.precision import check_gamma, check_harmonics
from model.tones import Forcing


class FlightFlag(enum.IntFlag):
    """What is special about a flight."""

    UNDECIDED = segment.UNDECIDED
    """It grazed the plate closer than double precision can tell."""
    RESTS = ideal.RESTS
    """There was none: the ball does not leave."""


@dataclass(frozen=True)
class Windows:
    """Take-off windows of one period: in ``[start[i], stop[i])`` a ball at rest leaves; ``start`` is in [0, 2 pi)."""

    start: Floats
    stop: Floats


@dataclass(frozen=True)
class Landing:
    """Flight time and impact speed relative to the plate (units 1/w and g/w), and what is special about the flight."""

    tau: float
    impact_speed: float
    flag: FlightFlag


@lru_cache(maxsize=64)
def turning_points(forcing: Forcing) -> Floats:
    """Phases in [0, 2 pi) where the plate's jerk vanishes: gamma-independent, so computed once for each forcing.

    Raises
    ------
    ValueError
        If a harmonic is no integer.
    """
    if not forcing.periodic:
        raise ValueError(f"harmonics {forcing.harmonic} are not all integers: the motion has no period of 2 pi")
    if not forcing.moves:
        return np.empty(0)
    check_harmonics(forcing)
    return np.asarray(branches.turning_points(forcing.tones, 0.0, branches.TWO_PI))


def edges(forcing: Forcing, gamma: float) -> tuple[Floats, int]:
    """The kernels' table of window edges and their number (`model.flight.branches.fill_edges`).

    Raises
    ------
    ValueError
        If gamma is negative, not finite or too large (`model.flight.precision`), or the forcing not periodic.
    """
    check_gamma(forcing, gamma)
    turning = turning_points(forcing)
    table = np.zeros(turning.size + 2)
    return table, branches.fill_edges(forcing.tones, turning, gamma, table)


def take_off_phases(forcing: Forcing, gamma: float) -> Windows:
    """Every take-off window of a period: where ``gamma sum_j b_j n_j^2 sin(n_j phi + p_j) >= 1``; may be none."""
    table, n = edges(forcing, gamma)
    return Windows(table[0 : 2 * n : 2].copy(), table[1 : 2 * n : 2].copy())


def relative_height(forcing: Forcing, gamma: float, phi0: ArrayLike, tau: ArrayLike, v0: ArrayLike = 0.0) -> Floats:
    """Height above the plate ``tau`` after a take-off at ``phi0`` with relative speed ``v0`` (the paper's eq. 4).

    For pictures and checks: plain arithmetic, any ``tau`` (negative too), arrays broadcast, units g/w^2.
    """
    start, t, v = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (phi0, tau, v0)))
    n, b, p = forcing.tones.T
    angle = n * start[..., None] + p
    x = n * t[..., None]
    moved = (b * (np.sin(angle) + x * np.cos(angle) - np.sin(angle + x))).sum(axis=-1)
    return np.asarray(gamma * moved + v * t - 0.5 * t * t)


def first_landing(forcing: Forcing, gamma: float, phi0: float, v0: float = 0.0) -> Landing:
    """The first landing after ``phi0``, proven first.

    Parameters
    ----------
    forcing, gamma
        The plate.
    phi0 : float
        Take-off phase, any turn. With ``v0 = 0`` outside the take-off windows the ball rests: flag RESTS, tau 0.
        A phase within rounding of a threshold is taken as that threshold.
    v0 : float
        Speed relative to the plate, not negative, units g/w.

    Raises
    ------
    ValueError
        If an argument is not finite or out of range, or the forcing not periodic.
    """
    if not (math.isfinite(phi0) and math.isfinite(v0) and v0 >= 0.0):
        raise ValueError(f"phi0 must be finite and v0 finite and not negative, not {phi0} and {v0}")
    table, n = edges(forcing, gamma)
    phi = branches.fold(phi0, table[0])
    # a phase this near to a threshold is that threshold: rounded otherwise, the ball would wait a period for the next
    snap = 2e-15 * max(1.0, abs(phi0))
    for threshold in table[0 : 2 * n + 1 : 2] if n else ():
        if abs(phi - threshold) <= snap:
            phi = table[0] if threshold == table[2 * n] else threshold
            tau, _, speed, flag = ideal.land(forcing.tones, gamma, table, n, phi, 0.0, v0)
            return Landing(tau, speed, FlightFlag(flag))
    a0 = gamma * branches.q_and_slope(forcing.tones, phi)[0] - 1.0
    if v0 == 0.0 and (n == 0 or branches.branch_of(table, n, phi) % 2 == 1):
        return Landing(0.0, 0.0, FlightFlag.RESTS)
    tau, _, speed, flag = ideal.land(forcing.tones, gamma, table, n, phi, a0, v0)
    return Landing(tau, speed, FlightFlag(flag))
