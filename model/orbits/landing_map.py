"""Where the flight times of irregular motion lie: branches of the landing map, and how often each is flown.

A flight belongs to the branch ``m`` if ``m`` crests of the plate are over when the ball lands. Between two branches the
ball just misses the falling side of a crest, and its landing leaps to the next rise. The share of each flight time
follows from the map itself, without an orbit: states after an impact (phase, speed) are divided into cells, each cell
sends its flights to other cells, and the shares that this leaves unchanged are those of the motion in the long run
(Ulam 1960, A Collection of Mathematical Problems, VI.4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix

from kernels.arrays import Floats, Integers
from kernels.errors import InputError
from model.flight.branches import TWO_PI
from model.orbits.attractor import AT_REST, Ball, State

FINER = 2.0  # power by which cells of small speed are finer: the bounces of a chatter shrink by a factor


@dataclass(frozen=True)
class LandingMap:
    """One flight from each of many states, arrays of equal length."""

    phase: Floats  # of the take-off: radians within one period
    speed: Floats  # off the plate in g/w
    tau: Floats  # flight time, 1/w
    branch: Integers  # see `branch_of`
    share: Floats  # part of all flights in the long run; the sum is 1


def branch_of(phase: ArrayLike, tau: ArrayLike, over: float = math.pi) -> Integers:
    """How often the plate passes the phase ``over`` between take-off at ``phase`` and landing ``tau`` later, radians.

    At pi a sine is half-way down, where hardly a ball lands.
    """
    start = np.asarray(phase, dtype=np.float64) - over
    turns = np.floor((start + np.asarray(tau)) / TWO_PI) - np.floor(start / TWO_PI)
    return np.asarray(turns, dtype=np.int64)


def landing_map(ball: Ball, gamma: float, rng: np.random.Generator, *, spread: float = 0.005) -> LandingMap:
    """Flights from every cell of take-off states, with their share in the long run.

    Raises `InputError` where the ball rests on the plate, or never rebounds.

    ``ball`` must rebound; ``spread`` is the relative standard deviation of gamma from flight to flight, which an
    amplitude control leaves.
    """
    path = ball.fly(gamma, AT_REST, 4096)
    fastest = float(np.max(np.where(path.reset[1:], 0.0, path.speed[:-1]), initial=0.0))
    if fastest == 0.0:
        raise InputError(f"gamma = {gamma:g}: the ball never takes off from an impact; its landing map has one state")
    columns, rows, flights = 120, 40, 4  # cells in phase and in speed, and flights from each
    n_cells = columns * rows + 1  # the last cell is rest: whatever comes there waits for the threshold
    source = np.append(np.repeat(np.arange(n_cells - 1), flights), [n_cells - 1] * flights)
    at = rng.random((source.size, 2))
    phase = (source // rows + at[:, 0]) / columns * TWO_PI
    speed = fastest * ((source % rows + at[:, 1]) / rows) ** FINER
    speed[-flights:] = 0.0
    tau, target = np.empty(source.size), np.empty(source.size, dtype=np.int64)
    for k, own in enumerate(gamma * (1.0 + spread * rng.standard_normal(source.size))):
        start = State(float(phase[k]), float(speed[k])) if speed[k] > 0.0 else AT_REST
        one = ball.fly(float(own), start, 1)
        tau[k], phase[k] = one.tau[0], one.phase[0] % TWO_PI
        column = int(one.last.phase % TWO_PI / TWO_PI * columns) % columns
        row = min(int((one.last.speed / fastest) ** (1.0 / FINER) * rows), rows - 1)
        target[k] = n_cells - 1 if one.last.speed <= 0.0 else column * rows + row
    onward = csr_matrix((np.full(source.size, 1.0 / flights), (target, source)), shape=(n_cells, n_cells))
    share = np.full(n_cells, 1.0 / n_cells)
    # a flight's memory lasts a few landings, so the shares have settled long before
    for _ in range(400):
        share = 0.5 * (share + onward @ share)  # halves: a cycle's cells would take turns for ever
    return LandingMap(phase, speed, tau, branch_of(phase, tau), share[source] / flights)
