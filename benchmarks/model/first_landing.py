"""The compiled kernels of the ideal ball for tests and benchmarks, a flight at a time; dimensionless.

Arguments are checked, and what is special about a flight has a name.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from kernels.arrays import Floats
from model.flight import branches, ideal, segment
from model.flight.windows import edges
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


def take_off_phases(forcing: Forcing, gamma: float) -> Windows:
    """Every take-off window of a period: where ``gamma sum_j b_j n_j^2 sin(n_j phi + p_j) >= 1``; may be none."""
    table, n = edges(forcing, gamma)
    return Windows(table[0 : 2 * n : 2].copy(), table[1 : 2 * n : 2].copy())


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
