"""The ball with Coulomb friction and restitution as `model.orbits.attractor` wants it, by the exact kernel.

The rule kept here: as in `model.orbits.ideal_ball`. Without restitution its state after a landing is one phase, and its
bifurcations have equations of their own (`model.bifurcations.events`); with restitution it is a phase and a speed.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.flight import first_landing
from model.flight.branches import TWO_PI
from model.flight.friction import fill_rough_edges
from model.orbits import friction_cycles as kernel
from model.orbits.attractor import LockedCycle, Path, State
from model.orbits.ideal_ball import IdealBall, Itinerary, has_shorter, resting
from model.orbits.ideal_cycles import SIGNATURE_SIZE
from model.precision import check_gamma, lengthened
from model.tones import Forcing

Floats = NDArray[np.float64]
Tables = tuple[Floats, int, Floats, int]


@dataclass(frozen=True)
class _Flown:
    """What the kernel filled, and what it returned."""

    tau: Floats
    phase: Floats
    speed: Floats
    index: NDArray[np.int64]
    threshold: NDArray[np.int64]
    mark: NDArray[np.int64]
    first: int
    periods: int
    last: State


@dataclass(frozen=True)
class FrictionBall:
    """A ball with friction ``mu_up``, ``mu_down`` and restitution ``e0 - e1 v`` (v in g/w) on ``forcing``."""

    forcing: Forcing
    mu_up: float = 0.0
    mu_down: float = 0.0
    e0: float = 0.0
    e1: float = 0.0

    @property
    def rough(self) -> tuple[float, float, float, float]:
        """As the kernels take it."""
        return self.mu_up, self.mu_down, self.e0, self.e1

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

    def _tables(self, gamma: float) -> Tables:
        self._check(gamma)
        turning = first_landing.turning_points(self.forcing)
        up, down = np.zeros((2, turning.size + 2))
        n_up, n_down = fill_rough_edges(self.forcing.tones, turning, gamma, self.rough, up, down)
        return up, n_up, down, n_down

    def _fly(self, gamma: float, start: State, max_flights: int) -> _Flown:
        up, n_up, down, n_down = self._tables(gamma)
        tau, phase, speed = np.empty((3, max_flights))
        index, threshold, mark = np.empty((3, max_flights), dtype=np.int64)
        first, stop, periods, phi, v = kernel.fly_rough_until_closed(
            self.forcing.tones,
            gamma,
            up,
            n_up,
            down,
            n_down,
            self.rough,
            start.phase,
            start.speed,
            tau,
            phase,
            speed,
            index,
            threshold,
            mark,
        )
        n = slice(0, stop)
        return _Flown(tau[n], phase[n], speed[n], index[n], threshold[n], mark[n], first, periods, State(phi, v))

    def fly(self, gamma: float, start: State, max_flights: int) -> Path:
        """See `model.orbits.attractor.Ball.fly`."""
        if self._tables(gamma)[1] == 0:
            return resting(start)
        flown = self._fly(gamma, start, max_flights)
        if flown.tau.size == 0:
            return resting(flown.last)
        return Path(
            flown.tau,
            flown.phase,
            flown.speed,
            np.full(flown.tau.size, math.nan),
            flown.threshold >= 0,
            (flown.mark & kernel.CHATTERS) > 0,
            flown.first,
            flown.periods,
            flown.last,
        )

    def signatures(self, gammas: Floats, max_flights: int) -> NDArray[np.int64]:
        """Signatures (`model.orbits.ideal_cycles`) of the orbits from rest at each gamma, shape (m, SIGNATURE_SIZE)."""
        self._check(gammas)
        out = np.empty((len(gammas), SIGNATURE_SIZE), dtype=np.int64)
        turning = first_landing.turning_points(self.forcing)
        kernel.rough_signatures(self.forcing.tones, turning, np.ascontiguousarray(gammas), self.rough, max_flights, out)
        return out

    def itinerary(self, gamma: float, max_flights: int) -> Itinerary:
        """Where the orbit from rest at ``gamma`` goes until it closes."""
        flown = self._fly(gamma, State(), max_flights)
        start = self._tables(gamma)[0][0]
        landing = np.mod(flown.phase + flown.tau - start, TWO_PI) + start
        kept: list[int] = []
        pending: list[int] = []
        rests: list[bool] = []
        entry = -1
        for k, bits in enumerate(flown.mark):
            if k == flown.first:
                entry = len(kept)
            pending.append(k)
            if bits & kernel.CHATTERS:
                pending = pending[:1]
            if bits & kernel.CHATTERS or k + 1 == flown.tau.size or not flown.mark[k + 1] & kernel.SMALL:
                kept += pending
                rests += [False] * (len(pending) - 1) + [bool(bits & kernel.CHATTERS)]
                pending = []
        return Itinerary(landing[kept], flown.index[kept], np.array(rests, dtype=bool), entry)

    def locked_family(self, gamma: float, window: int, after: float, n: int) -> tuple[bool, float, float, float, int]:
        """See `model.orbits.ideal_cycles.locked_family`; for a ball that does not rebound."""
        turning = first_landing.turning_points(self.forcing)
        return kernel.rough_locked_family(self.forcing.tones, turning, gamma, self.rough, window, after, n)

    @property
    def take_off_levels(self) -> tuple[Floats, Floats]:
        """See `model.orbits.ideal_ball.IdealBall.take_off_levels`: friction raises them all by ``1 + mu_up``."""
        births, merges = IdealBall(self.forcing).take_off_levels
        return births * (1.0 + self.mu_up), merges * (1.0 + self.mu_up)

    def close(self, gamma: float, near: State, n: int) -> LockedCycle | None:
        """See `model.orbits.attractor.Ball.close`."""
        if self._tables(gamma)[1] == 0:
            return None
        phases, taus, speeds, starts = np.empty((4, n))
        ok, periods, trace, determinant = kernel.close_rough_cycle(
            self.forcing.tones,
            first_landing.turning_points(self.forcing),
            gamma,
            self.rough,
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
