"""Every flight of an orbit, one after another; the cycle of a closed orbit is repeated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kernels.arrays import Bools, Floats
from model.flight.branches import TWO_PI
from model.orbits.attractor import AT_REST, Ball, State


@dataclass(frozen=True)
class Series:
    """Flights, arrays of equal length: time, take-off phase in [0, 2 pi), and whether from rest at a threshold."""

    tau: Floats
    phase: Floats
    reset: Bools


def every_flight(ball: Ball, gamma: float, n_transient: int, n_keep: int, start: State = AT_REST) -> Series:
    """``n_keep`` flights after ``n_transient`` from ``start``; flights of length 0 where the ball rests."""
    path = ball.fly(gamma, start, n_transient + n_keep)
    size = path.tau.size
    if size == 0:
        return Series(np.zeros(n_keep), np.full(n_keep, start.phase % TWO_PI), np.zeros(n_keep, dtype=bool))
    k = np.arange(n_transient, n_transient + n_keep)
    if path.first >= 0:
        k = np.where(k < size, k, path.first + (k - path.first) % (size - path.first))
    k = k[k < size]
    return Series(path.tau[k], np.mod(path.phase[k], TWO_PI), path.reset[k])
