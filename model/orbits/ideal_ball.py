"""The ideal ball as a `model.orbits.attractor.Ball`, by the exact kernel.

A ball knows its plate's tones and its effects and nothing of gamma.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kernels.arrays import Bools, Floats, Integers
from model.flight import first_landing, ideal
from model.flight.branches import TWO_PI, fold, q_and_slope
from model.flight.precision import check_gamma
from model.flight.records import FrictionRestitution
from model.orbits import ideal_cycles
from model.orbits.attractor import LockedCycle, Path, State
from model.orbits.cycles import CODE_SIZE, room_for
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
class IdealBall:
    """The completely inelastic ball on ``forcing``, nothing added."""

    forcing: Forcing
    bounces: ClassVar[bool] = False
    most_flights: ClassVar[int] = 64
    coarse: ClassVar[float] = 1e-5

    def fly(self, gamma: float, start: State, max_flights: int) -> Path:
        """See `model.orbits.attractor.Ball.fly`."""
        edge, n_windows = first_landing.edges(self.forcing, gamma)
        if n_windows == 0 and start.speed <= 0.0:
            return resting(start)
        lead_tau: list[float] = []
        rest_at, lead_speed, at = start.phase, 0.0, 0.0
        if start.speed > 0.0:
            at = fold(start.phase, edge[0])
            a0 = gamma * q_and_slope(self.forcing.tones, at)[0] - 1.0
            tau, rest_at, lead_speed, _ = ideal.land(self.forcing.tones, gamma, edge, n_windows, at, a0, start.speed)
            lead_tau = [tau]
            if n_windows == 0:
                return resting(State(rest_at % TWO_PI))
        flown = room_for(max_flights)
        first, stop, periods = ideal_cycles.fly_until_closed(self.forcing.tones, gamma, edge, n_windows, rest_at, flown)
        tau_, phase, speed, _, threshold, _ = flown.upto(stop)
        lead = len(lead_tau)
        slope = self._slopes(gamma, phase, tau_, speed, threshold)
        return Path(
            np.concatenate([lead_tau, tau_]),
            np.concatenate([[at] * lead, phase]),
            np.concatenate([[lead_speed] * lead, speed]),
            np.concatenate([[math.nan] * lead, slope]),
            np.concatenate([np.zeros(lead, dtype=bool), threshold >= 0]),
            np.zeros(stop + lead, dtype=bool),
            first + lead if first >= 0 else -1,
            periods,
            State(float(fold(phase[stop - 1] + tau_[stop - 1], edge[0]))),
        )

    def _slopes(self, gamma: float, phase: Floats, tau: Floats, speed: Floats, threshold: Integers) -> Floats:
        """``d landing / d take-off = -tau h''(take-off) / impact speed``; 0 at a threshold, where h'' vanishes."""
        h2 = gamma * _q(self.forcing, phase) - 1.0
        h2[threshold >= 0] = 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(-tau * h2 / speed)

    def close(self, gamma: float, near: State, n: int) -> LockedCycle | None:
        """See `model.orbits.attractor.Ball.close`."""
        edge, n_windows = first_landing.edges(self.forcing, gamma)
        if n_windows == 0:
            return None
        phases, taus = np.empty((2, n))
        ok, _, periods, multiplier = ideal_cycles.close_cycle(
            self.forcing.tones, gamma, edge, n_windows, near.phase, phases, taus
        )
        if not ok or has_shorter(phases):
            return None
        turn = int(np.argmin(np.mod(phases, TWO_PI)))
        phases, taus = np.roll(np.mod(phases, TWO_PI), -turn), np.roll(taus, -turn)
        forcing = self.forcing
        speeds = np.array([first_landing.first_landing(forcing, gamma, p).impact_speed for p in phases])
        return LockedCycle(phases, np.zeros(n), taus, speeds, periods, multiplier)

    def itinerary_codes(self, gammas: Floats, max_flights: int) -> Integers:
        """Codes (`model.orbits.cycles`) of the orbits from rest at each gamma, shape (m, CODE_SIZE)."""
        check_gamma(self.forcing, gammas)
        out = np.empty((len(gammas), CODE_SIZE), dtype=np.int64)
        turning = first_landing.turning_points(self.forcing)
        grid = np.ascontiguousarray(gammas)
        ideal_cycles.itinerary_codes(
            self.forcing.tones, turning, grid, FrictionRestitution(), room_for(max_flights), out
        )
        return out

    def itinerary(self, gamma: float, max_flights: int) -> Itinerary:
        """Where the orbit from rest at ``gamma`` goes until it closes."""
        edge, n_windows = first_landing.edges(self.forcing, gamma)
        flown = room_for(max_flights)
        first, stop, _ = ideal_cycles.fly_until_closed(self.forcing.tones, gamma, edge, n_windows, 0.0, flown)
        landing = np.mod(flown.phase[:stop] + flown.tau[:stop] - edge[0], TWO_PI) + edge[0]
        return Itinerary(landing, flown.symbol[:stop], np.zeros(stop, dtype=bool), first)

    def locked_family(self, gamma: float, window: int, after: float, n: int) -> tuple[bool, float, float, float, int]:
        """See `model.orbits.cycles.locked_family_of`."""
        turning = first_landing.turning_points(self.forcing)
        found: tuple[bool, float, float, float, int] = ideal_cycles.locked_family(
            self.forcing.tones, turning, gamma, FrictionRestitution(), window, after, n
        )
        return found

    @property
    def take_off_levels(self) -> tuple[Floats, Floats]:
        """Gammas at which a take-off window is born (the least is take-off itself), and at which two merge."""
        turning = first_landing.turning_points(self.forcing)
        q = _q(self.forcing, turning)
        before, after = _q(self.forcing, turning - 1e-3), _q(self.forcing, turning + 1e-3)
        maximum = (q > before) & (q > after) & (q > 0)
        minimum = (q < before) & (q < after) & (q > 0)
        return np.sort(1.0 / q[maximum]), np.sort(1.0 / q[minimum])

    @property
    def peak(self) -> float:
        """``max(-a_p) / g`` at gamma = 1."""
        q = _q(self.forcing, first_landing.turning_points(self.forcing))
        return float(q.max()) if q.size else 0.0


def resting(start: State) -> Path:
    """No flights at all."""
    none = np.empty(0)
    no = np.empty(0, dtype=bool)
    return Path(none, none, none, none, no, no, -1, 0, State(start.phase))


def _q(forcing: Forcing, phase: Floats) -> Floats:
    n, b, p = forcing.tones.T
    return np.asarray((b * n * n * np.sin(n * phase[:, None] + p)).sum(axis=1))


def has_shorter(phases: Floats) -> bool:
    """Whether a cycle is a shorter one run through several times."""
    n = phases.size
    return any(n % k == 0 and bool(np.all(np.abs(phases - np.roll(phases, k)) < 1e-9)) for k in range(1, n))
