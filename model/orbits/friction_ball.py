"""The ball with Coulomb friction and restitution as a `model.orbits.attractor.Ball`, by the exact kernel.

Without restitution its state after a landing is one phase, and its bifurcations have equations of their own
(`model.bifurcations.events`); with restitution it is a phase and a speed.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from kernels.arrays import Floats, Integers
from model.flight import first_landing
from model.flight.branches import TWO_PI
from model.flight.friction import edge_tables
from model.flight.precision import check_gamma, lengthened
from model.flight.records import EdgeTables, FrictionRestitution
from model.orbits import friction_cycles
from model.orbits.attractor import LockedCycle, Path, State
from model.orbits.cycles import CHATTERS, CODE_SIZE, SMALL, Flown, room_for
from model.orbits.ideal_ball import IdealBall, Itinerary, has_shorter, resting
from model.tones import Forcing


@dataclass(frozen=True)
class FrictionBall:
    """A ball with friction ``mu_up``, ``mu_down`` and restitution ``e0 - e1 v`` (v in g/w) on ``forcing``.

    Friction is in units of the weight; restitution is kept within [0, 1].

    Raises
    ------
    ValueError
        If a value is not finite or out of range; with ``mu_down >= 1`` the ball would stay on the rod of a still plate.
    """

    forcing: Forcing
    mu_up: float = 0.0
    mu_down: float = 0.0
    e0: float = 0.0
    e1: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what has no meaning."""
        if not all(map(math.isfinite, self.law)):
            raise ValueError(f"friction and restitution must be finite, not {self.law}")
        if not (self.mu_up >= 0.0 and 0.0 <= self.mu_down < 1.0):
            raise ValueError(f"friction must satisfy 0 <= mu_up and 0 <= mu_down < 1, not {self.mu_up}, {self.mu_down}")
        if not 0.0 <= self.e0 <= 1.0:
            raise ValueError(f"restitution at speed zero must be within [0, 1], not {self.e0}")

    @property
    def law(self) -> FrictionRestitution:
        """Friction and restitution as the kernels take them."""
        return FrictionRestitution(float(self.mu_up), float(self.mu_down), float(self.e0), float(self.e1))

    @property
    def bounces(self) -> bool:
        """Whether an impact can throw it back."""
        return self.e0 > 0.0 or self.e1 < 0.0

    @property
    def most_flights(self) -> int:
        """Enough for a cycle of 32 flights, and for the bounces of a chatter."""
        if not self.bounces:
            return 64
        return 128 if self.e0 < 0.7 and self.e1 >= 0.0 else 512

    @property
    def coarse(self) -> float:
        """Spacing in gamma of the search that goes everywhere."""
        return 1e-5 if not self.bounces else 1e-3

    def _check(self, gamma: float | Floats) -> None:
        check_gamma(self.forcing, gamma, lengthened(self.mu_down, self.e0))

    def _tables(self, gamma: float) -> EdgeTables:
        self._check(gamma)
        return edge_tables(self.forcing.tones, first_landing.turning_points(self.forcing), gamma, self.law)

    def _fly(self, gamma: float, start: State, max_flights: int) -> tuple[Flown, int, int, State]:
        """The flights, the first of the cycle, its periods, and the state in which the ball was left."""
        flown = room_for(max_flights)
        first, stop, periods, phi, v = friction_cycles.fly_until_closed(
            self.forcing.tones, gamma, self._tables(gamma), self.law, start.phase, start.speed, flown
        )
        return flown.upto(stop), first, periods, State(phi, v)

    def fly(self, gamma: float, start: State, max_flights: int) -> Path:
        """See `model.orbits.attractor.Ball.fly`."""
        if self._tables(gamma).n_up == 0:
            return resting(start)
        flown, first, periods, last = self._fly(gamma, start, max_flights)
        if flown.tau.size == 0:
            return resting(last)
        return Path(
            flown.tau,
            flown.phase,
            flown.speed,
            np.full(flown.tau.size, math.nan),
            flown.threshold >= 0,
            (flown.mark & CHATTERS) > 0,
            first,
            periods,
            last,
        )

    def itinerary_codes(self, gammas: Floats, max_flights: int) -> Integers:
        """Codes (`model.orbits.cycles`) of the orbits from rest at each gamma, shape (m, CODE_SIZE)."""
        self._check(gammas)
        out = np.empty((len(gammas), CODE_SIZE), dtype=np.int64)
        turning = first_landing.turning_points(self.forcing)
        grid = np.ascontiguousarray(gammas)
        friction_cycles.itinerary_codes(self.forcing.tones, turning, grid, self.law, room_for(max_flights), out)
        return out

    def itinerary(self, gamma: float, max_flights: int) -> Itinerary:
        """Where the orbit from rest at ``gamma`` goes until it closes."""
        flown, first, _, _ = self._fly(gamma, State(), max_flights)
        start = self._tables(gamma).up[0]
        landing = np.mod(flown.phase + flown.tau - start, TWO_PI) + start
        kept: list[int] = []
        pending: list[int] = []
        rests: list[bool] = []
        entry = -1
        for k, bits in enumerate(flown.mark):
            if k == first:
                entry = len(kept)
            pending.append(k)
            if bits & CHATTERS:
                pending = pending[:1]
            if bits & CHATTERS or k + 1 == flown.tau.size or not flown.mark[k + 1] & SMALL:
                kept += pending
                rests += [False] * (len(pending) - 1) + [bool(bits & CHATTERS)]
                pending = []
        return Itinerary(landing[kept], flown.symbol[kept], np.array(rests, dtype=bool), entry)

    def locked_family(self, gamma: float, window: int, after: float, n: int) -> tuple[bool, float, float, float, int]:
        """See `model.orbits.cycles.locked_family_of`; for a ball that does not rebound."""
        turning = first_landing.turning_points(self.forcing)
        found: tuple[bool, float, float, float, int] = friction_cycles.locked_family(
            self.forcing.tones, turning, gamma, self.law, window, after, n
        )
        return found

    @property
    def take_off_levels(self) -> tuple[Floats, Floats]:
        """See `model.orbits.ideal_ball.IdealBall.take_off_levels`: friction raises them all by ``1 + mu_up``."""
        births, merges = IdealBall(self.forcing).take_off_levels
        return births * (1.0 + self.mu_up), merges * (1.0 + self.mu_up)

    def close(self, gamma: float, near: State, n: int) -> LockedCycle | None:
        """See `model.orbits.attractor.Ball.close`."""
        if self._tables(gamma).n_up == 0:
            return None
        phases, taus, speeds, starts = np.empty((4, n))
        ok, periods, trace, determinant = friction_cycles.close_cycle(
            self.forcing.tones,
            first_landing.turning_points(self.forcing),
            gamma,
            self.law,
            near.phase,
            near.speed,
            n,
            phases,
            taus,
            speeds,
            starts,
        )
        if not ok or has_shorter(phases):
            return None
        root = cmath.sqrt(trace * trace / 4.0 - determinant)
        multiplier = max((trace / 2.0 + root, trace / 2.0 - root), key=abs)
        size = multiplier.real if multiplier.imag == 0.0 else math.copysign(abs(multiplier), multiplier.real)
        turn = -int(np.argmin(np.mod(phases, TWO_PI)))
        phases, starts, taus, speeds = (np.roll(x, turn) for x in (np.mod(phases, TWO_PI), starts, taus, speeds))
        return LockedCycle(phases, starts, taus, speeds, periods, size)
