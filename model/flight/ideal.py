"""One ideal flight, compiled: the first landing, proven first, and how it stretches a small shift of the take-off.

A landing is returned only when every earlier branch of the flight (`model.flight.branches`) is
proven free of roots (`model.flight.segment`). `tables_of`, `flight`, `flight_and_tangent` and `after_impact` are what
`model.orbits.cycles` takes of a ball.
"""

from __future__ import annotations

import numpy as np

from kernels.arrays import Floats
from model.flight.branches import branch_of, fill_edges, fold, q_and_slope
from model.flight.numerics import EdgeTables, FrictionRestitution, Segment, Tangent, compiled, inlined
from model.flight.segment import UNDECIDED, landing_or_standstill, motion, shape

RESTS = 4  # the ball does not leave at this phase


@compiled
def land(
    tones: Floats, gamma: float, edge: Floats, n_windows: int, phi0: float, a0: float, v0: float
) -> tuple[float, float, float, int]:
    """The first landing after the take-off at the folded phase ``phi0``.

    Returns tau, landing phase (folded into the period of ``edge``), impact speed, flag.

    Parameters
    ----------
    tones, edge, n_windows
        A periodic forcing and its table (`model.flight.branches.fill_edges`).
    gamma : float
        Drive amplitude.
    phi0 : float
        Take-off phase in ``[edge[0], edge[0] + 2 pi)``.
    a0 : float
        ``gamma q(phi0) - 1``; exactly 0 at a threshold.
    v0 : float
        Speed relative to the plate, >= 0; with 0 the phase must be inside a window.
    """
    s0, slope0, _ = shape(tones, phi0)
    segment = Segment(phi0, s0, slope0, a0, v0, 0.0, 1.0)
    i = branch_of(edge, n_windows, phi0)
    if n_windows > 0 and i % 2 == 0:
        tau = edge[i + 1] - phi0
        if tau < 1e-7 and motion(tones, gamma, segment, edge[i + 1], tau)[0] <= 0.0:  # lifted by less than rounding
            return 3.0 * tau, fold(phi0 + 3.0 * tau, edge[0]), 0.0, UNDECIDED
    _, tau, phi, speed, flag = landing_or_standstill(tones, gamma, edge, n_windows, segment, False)
    return tau, phi, speed, flag


@compiled
def tables_of(tones: Floats, turning: Floats, gamma: float, law: FrictionRestitution) -> EdgeTables:
    """The one table of the ideal ball, for both ways."""
    edge = np.zeros(turning.shape[0] + 2)
    n_windows = fill_edges(tones, turning, gamma, edge)
    return EdgeTables(edge, n_windows, edge, n_windows)


@compiled
def take_off_pull(tones: Floats, gamma: float, phi0: float, at_threshold: bool) -> float:
    """``h''`` at a take-off inside a window: exactly 0 at its threshold."""
    return 0.0 if at_threshold else max(gamma * q_and_slope(tones, phi0)[0] - 1.0, 0.0)


@inlined
def flight(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi0: float, v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, int]:  # fmt: skip
    """`land` with the arguments of `model.flight.friction.land_with_friction`."""
    a0 = gamma * q_and_slope(tones, phi0)[0] - 1.0 if v0 > 0.0 else take_off_pull(tones, gamma, phi0, at_threshold)
    return land(tones, gamma, tables.up, tables.n_up, phi0, a0, v0)


@compiled
def flight_and_tangent(
    tones: Floats, gamma: float, tables: EdgeTables, law: FrictionRestitution, phi0: float, v0: float,
    at_threshold: bool,
) -> tuple[float, float, float, Tangent]:  # fmt: skip
    """A flight from rest, and its tangent: ``d landing / d take-off = -tau h''(take-off) / impact speed``."""
    a0 = take_off_pull(tones, gamma, phi0, at_threshold)
    tau, landing, speed, _ = land(tones, gamma, tables.up, tables.n_up, phi0, a0, 0.0)
    return tau, landing, speed, (-tau * a0 / speed, 0.0, 0.0, 0.0)


@inlined
def after_impact(
    tones: Floats, gamma: float, law: FrictionRestitution, phi: float, speed: float
) -> tuple[float, float]:
    """As `model.flight.friction.rebound_or_rest`: the ball stays where it lands."""
    return 0.0, 0.0
