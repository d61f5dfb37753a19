"""Balls flown by the exact kernels, each a `model.orbits.attractor.Ball`: ideal, and with friction and restitution.

A ball knows its plate's tones and its effects and nothing of gamma. Without restitution its state after a landing is
one phase, and its bifurcations have equations of their own (`model.bifurcations.events`); with restitution it is a
phase and a speed. The flight of the ideal ball is a kernel of its own, three to five times as fast. Decision 351.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kernels.arrays import Bools, Floats, Integers
from kernels.errors import InputError
from model.flight import windows
from model.flight.branches import TWO_PI
from model.flight.numerics import EdgeTables, FrictionRestitution
from model.flight.windows import check_gamma, lengthened
from model.orbits.attractor import LockedCycle, Path, State, locked_cycle
from model.orbits.cycles import CHATTERS, CODE_SIZE, FRICTION, IDEAL, SMALL, Cycles, Flown, room_for
from model.tones import Forcing


@dataclass(frozen=True)
class Itinerary:
    """Where an orbit from rest went: landing phases (folded), symbols, and the first flight of the cycle.

    ``symbol`` counts branches (`model.orbits.cycles`); ``rests`` marks landings from which a completed chatter
    leads to rest (its small bounces are left out); ``first = -1`` when the orbit did not close.
    """

    landing: Floats
    symbol: Integers
    rests: Bools
    first: int


@dataclass(frozen=True)
class ExactBall:
    """A ball on ``forcing`` whose orbits from rest close at a threshold; ``cycles`` are the kernels that fly it."""

    forcing: Forcing
    cycles: ClassVar[Cycles]

    @property
    def law(self) -> FrictionRestitution:
        """Friction and restitution as the kernels take them."""
        return FrictionRestitution()

    @property
    def bounces(self) -> bool:
        """Whether an impact can throw it back; then the state after a landing is a phase and a speed."""
        return self.law.e0 > 0.0 or self.law.e1 < 0.0

    @property
    def most_flights(self) -> int:
        """Before an orbit from rest is given up in a search for cycles: the way into the cycle and the cycle."""
        if not self.bounces:
            return 64
        # enough for a cycle of 32 flights, and for the bounces of a chatter
        return 128 if self.law.e0 < 0.7 and self.law.e1 >= 0.0 else 512

    @property
    def coarse(self) -> float:
        """Spacing in gamma of the search that goes everywhere."""
        return 1e-5 if not self.bounces else 1e-3

    @property
    def take_off_levels(self) -> tuple[Floats, Floats]:
        """Gammas at which a take-off window is born (the least is take-off itself), and at which two merge.

        Friction raises them all by ``1 + mu_up``.
        """
        turning = windows.turning_points(self.forcing)
        q = _q(self.forcing, turning)
        # a window is born where gamma times a maximum of q reaches 1, and two merge at a minimum
        before, after = _q(self.forcing, turning - 1e-3), _q(self.forcing, turning + 1e-3)
        maximum = (q > before) & (q > after) & (q > 0)
        minimum = (q < before) & (q < after) & (q > 0)
        return tuple(np.sort(1.0 / q[which]) * (1.0 + self.law.mu_up) for which in (maximum, minimum))  # type: ignore[return-value]

    def _tables(self, gamma: float) -> EdgeTables:
        check_gamma(self.forcing, gamma, lengthened(self.law.mu_down, self.law.e0))
        return self.cycles.tables_of(self.forcing.tones, windows.turning_points(self.forcing), gamma, self.law)

    def _fly(self, gamma: float, tables: EdgeTables, start: State, max_flights: int) -> tuple[Flown, int, int, State]:
        """The flights, the first of the cycle, its periods, and the state in which the ball was left."""
        flown = room_for(max_flights)
        first, stop, periods, phi, v = self.cycles.fly_until_closed(
            self.forcing.tones, gamma, tables, self.law, start.phase, start.speed, flown
        )
        return flown.upto(stop), first, periods, State(phi, v)

    def fly(self, gamma: float, start: State, max_flights: int) -> Path:
        """See `model.orbits.attractor.Ball.fly`."""
        tables = self._tables(gamma)
        if tables.n_up == 0:
            return resting(start)
        flown, first, periods, last = self._fly(gamma, tables, start, max_flights)
        if flown.tau.size == 0:
            return resting(last)
        resets, chatters = flown.threshold >= 0, (flown.mark & CHATTERS) > 0
        return Path(flown.tau, flown.phase, flown.speed, resets, chatters, first, periods, last)

    def itinerary(self, gamma: float, max_flights: int) -> Itinerary:
        """Where the orbit from rest at ``gamma`` goes until it closes."""
        tables = self._tables(gamma)
        flown, first, _, _ = self._fly(gamma, tables, State(), max_flights)
        start = tables.up[0]
        landing = np.mod(flown.phase + flown.tau - start, TWO_PI) + start
        shown: list[int] = []
        pending: list[int] = []
        rests: list[bool] = []
        entry = -1
        for k, bits in enumerate(flown.mark):
            if k == first:
                entry = len(shown)
            pending.append(k)
            if bits & CHATTERS:
                pending = pending[:1]
            if bits & CHATTERS or k + 1 == flown.tau.size or not flown.mark[k + 1] & SMALL:
                shown += pending
                rests += [False] * (len(pending) - 1) + [bool(bits & CHATTERS)]
                pending = []
        return Itinerary(landing[shown], flown.symbol[shown], np.array(rests, dtype=bool), entry)

    def itinerary_codes(self, gammas: Floats, max_flights: int) -> Integers:
        """Codes (`model.orbits.cycles`) of the orbits from rest at each gamma, shape (m, CODE_SIZE)."""
        check_gamma(self.forcing, gammas, lengthened(self.law.mu_down, self.law.e0))
        out = np.empty((len(gammas), CODE_SIZE), dtype=np.int64)
        turning = windows.turning_points(self.forcing)
        grid = np.ascontiguousarray(gammas)
        self.cycles.itinerary_codes(self.forcing.tones, turning, grid, self.law, room_for(max_flights), out)
        return out

    def close(self, gamma: float, near: State, n: int) -> LockedCycle | None:
        """See `model.orbits.attractor.Ball.close`."""
        tables = self._tables(gamma)
        if tables.n_up == 0:
            return None
        cycle = np.empty((4, n))
        ok, periods, trace, determinant = self.cycles.close_cycle(
            self.forcing.tones, gamma, tables, self.law, near.phase, near.speed, cycle
        )
        phases = cycle[1]
        # no cycle of n flights where a shorter one is run through several times
        shorter = (np.all(np.abs(phases - np.roll(phases, k)) < 1e-9) for k in range(1, n) if n % k == 0)
        if not ok or any(shorter):
            return None
        # eigenvalues of the 2 x 2 Jacobian by its trace and determinant
        root = cmath.sqrt(trace * trace / 4.0 - determinant)
        return locked_cycle(cycle, periods, (trace / 2.0 + root, trace / 2.0 - root))


@dataclass(frozen=True)
class IdealBall(ExactBall):
    """The completely inelastic ball on ``forcing``, nothing added."""

    cycles: ClassVar[Cycles] = IDEAL


@dataclass(frozen=True)
class FrictionBall(ExactBall):
    """A ball with friction ``mu_up``, ``mu_down`` and restitution ``e0 - e1 v`` (v in g/w) on ``forcing``.

    Friction is in units of the weight; restitution is clipped to [0, 1].

    Raises `InputError` if a value is not finite or out of range; with ``mu_down >= 1`` the ball would stay on the rod
    of a still plate.
    """

    cycles: ClassVar[Cycles] = FRICTION
    mu_up: float = 0.0
    mu_down: float = 0.0
    e0: float = 0.0
    e1: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what has no meaning."""
        if not all(map(math.isfinite, self.law)):
            raise InputError(f"friction and restitution must be finite, not {self.law}")
        if not (self.mu_up >= 0.0 and 0.0 <= self.mu_down < 1.0):
            raise InputError(f"friction must satisfy 0 <= mu_up and 0 <= mu_down < 1, not {self.mu_up}, {self.mu_down}")
        if not 0.0 <= self.e0 <= 1.0:
            raise InputError(f"restitution at speed zero must be within [0, 1], not {self.e0}")

    @property
    def law(self) -> FrictionRestitution:
        """Friction and restitution as the kernels take them."""
        return FrictionRestitution(float(self.mu_up), float(self.mu_down), float(self.e0), float(self.e1))


def resting(start: State) -> Path:
    """No flights at all."""
    none = np.empty(0)
    no = np.empty(0, dtype=bool)
    return Path(none, none, none, no, no, -1, 0, State(start.phase))


def _q(forcing: Forcing, phase: Floats) -> Floats:
    n, b, p = forcing.tones.T
    return np.asarray((b * n * n * np.sin(n * phase[:, None] + p)).sum(axis=1))
