"""The ideal ball on a plate of tones: take-off phases, one flight, many flights; dimensionless (see `model.tones`).

The rule kept here: this is the readable face of the compiled kernels (`model.flight.branches`, `model.flight.ideal`);
it checks what it is given and does no arithmetic of its own.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.flight import aperiodic, branches, ideal, segment
from model.precision import check_gamma, check_harmonics
from model.series import batched_ideal
from model.tones import Forcing

SNAP = 2e-15  # a phase this near to a threshold, relative, is that threshold
Floats = NDArray[np.float64]


class FlightFlag(enum.IntFlag):
    """What is special about a flight."""

    RESET = ideal.RESET
    """It started from rest, at a threshold."""
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


@dataclass(frozen=True)
class Orbit:
    """Successive flights, arrays of equal shape: time, take-off phase in [0, 2 pi), `FlightFlag` bits."""

    tau: Floats
    takeoff_phase: Floats
    flag: NDArray[np.int8]

    @property
    def reset(self) -> NDArray[np.bool_]:
        """Which flights started from rest at a threshold."""
        return np.asarray(self.flag & FlightFlag.RESET, dtype=bool)


@lru_cache(maxsize=64)
def turning_points(forcing: Forcing) -> Floats:
    """Phases in [0, 2 pi) where the plate's jerk vanishes: gamma-independent, so kept for each forcing."""
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
        If gamma is negative, not finite or too large (`model.precision`), or the forcing not periodic.
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
        If an argument is not finite or out of range.
    """
    if not (math.isfinite(phi0) and math.isfinite(v0) and v0 >= 0.0):
        raise ValueError(f"phi0 must be finite and v0 finite and not negative, not {phi0} and {v0}")
    if not forcing.periodic:
        return _first_landing_aperiodic(forcing, gamma, phi0, v0)
    table, n = edges(forcing, gamma)
    phi = branches.fold(phi0, table[0])
    snap = SNAP * max(1.0, abs(phi0))
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


def _first_landing_aperiodic(forcing: Forcing, gamma: float, phi0: float, v0: float) -> Landing:
    """`first_landing` on tones without a period: ``phi0`` is not folded."""
    check_gamma(forcing, gamma)
    leaves, waits = aperiodic.next_take_off_aperiodic(forcing.tones, gamma, phi0)
    at_threshold = waits and abs(leaves - phi0) <= SNAP * max(1.0, abs(phi0))
    if v0 == 0.0 and waits and not at_threshold:
        return Landing(0.0, 0.0, FlightFlag.RESTS)
    tau, speed, flag = aperiodic.land_aperiodic(
        forcing.tones, gamma, leaves if at_threshold else phi0, v0, at_threshold
    )
    return Landing(tau, speed, FlightFlag(flag))


def run_orbit(forcing: Forcing, gamma: float, n_transient: int, n_keep: int, phi0: float = 0.0) -> Orbit:
    """``n_keep`` flights at one gamma after ``n_transient``, from rest at ``phi0``.

    Below take-off every flight is zero and flagged RESTS.
    """
    batch = run_diagram(forcing, np.array([gamma]), n_transient, n_keep, phi0)
    return Orbit(batch.tau[0], batch.takeoff_phase[0], batch.flag[0])


def run_diagram(
    forcing: Forcing,
    gammas: ArrayLike,
    n_transient: int,
    n_keep: int,
    phi0: float = 0.0,
    *,
    every_flight: bool = False,
) -> Orbit:
    """`run_orbit` for many gammas: arrays of shape ``(len(gammas), n_keep)``.

    An orbit that repeats a threshold repeats exactly, so the rest of it is copied, unless ``every_flight`` asks for
    each flight to be flown (`model.series.batched_ideal`).

    Raises
    ------
    ValueError
        If a gamma is negative or not finite, or a count negative.

    Notes
    -----
    On tones without a common period (a harmonic that is no integer) the phases are not folded: they are ``w t``.
    """
    grid = np.ascontiguousarray(gammas, dtype=np.float64)
    check_gamma(forcing, grid)
    if n_transient < 0 or n_keep < 0:
        raise ValueError(f"flight counts must not be negative, not {n_transient} and {n_keep}")
    shape = (grid.size, n_keep)
    out = Orbit(np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.int8))
    if not forcing.periodic:
        aperiodic.aperiodic_diagram(forcing.tones, grid, phi0, n_transient, out.tau, out.takeoff_phase, out.flag)
        return out
    kept = (out.tau, out.takeoff_phase, out.flag)
    batched_ideal.lockstep_diagram(forcing.tones, turning_points(forcing), grid, phi0, n_transient, every_flight, kept)
    return out
