"""Balls on a plate as `model.orbits.attractor` wants them: the ideal one by the exact kernel.

The rule kept here: a ball knows its plate's tones and its effects and nothing of gamma; the arithmetic is the kernels'.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from model.flight import first_landing, ideal
from model.flight.branches import TWO_PI, fold, q_and_slope
from model.orbits import ideal_cycles
from model.orbits.attractor import LockedCycle, Path, State
from model.precision import check_gamma
from model.tones import Forcing

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Itinerary:
    """Where an orbit from rest went: landing phases (folded), landing indices, and the first flight of the cycle.

    ``index`` counts branches (`model.orbits.ideal_cycles`); ``rests`` marks landings from which a completed chatter
    leads to rest (its small bounces are left out); ``first = -1`` when the orbit did not close.
    """

    landing: Floats
    index: NDArray[np.int64]
    rests: NDArray[np.bool_]
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
        tau_, phase, speed = np.empty((3, max_flights))
        index, threshold = np.empty((2, max_flights), dtype=np.int64)
        first, stop, periods = ideal_cycles.fly_until_closed(
            self.forcing.tones, gamma, edge, n_windows, rest_at, tau_, phase, speed, index, threshold
        )
        kept = slice(0, stop)
        lead = len(lead_tau)
        slope = self._slopes(gamma, phase[kept], tau_[kept], speed[kept], threshold[kept])
        return Path(
            np.concatenate([lead_tau, tau_[kept]]),
            np.concatenate([[at] * lead, phase[kept]]),
            np.concatenate([[lead_speed] * lead, speed[kept]]),
            np.concatenate([[math.nan] * lead, slope]),
            np.concatenate([np.zeros(lead, dtype=bool), threshold[kept] >= 0]),
            np.zeros(stop + lead, dtype=bool),
            first + lead if first >= 0 else -1,
            periods,
            State(float(fold(phase[stop - 1] + tau_[stop - 1], edge[0]))),
        )

    def _slopes(self, gamma: float, phase: Floats, tau: Floats, speed: Floats, threshold: NDArray[np.int64]) -> Floats:
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
        index = np.empty(n, dtype=np.int64)
        ok, _, periods, multiplier = ideal_cycles.close_cycle(
            self.forcing.tones, gamma, edge, n_windows, near.phase, n, phases, taus, index
        )
        if not ok or has_shorter(phases):
            return None
        turn = int(np.argmin(np.mod(phases, TWO_PI)))
        phases, taus = np.roll(np.mod(phases, TWO_PI), -turn), np.roll(taus, -turn)
        forcing = self.forcing
        speeds = np.array([first_landing.first_landing(forcing, gamma, p).impact_speed for p in phases])
        return LockedCycle(phases, np.zeros(n), taus, speeds, periods, multiplier)

    def signatures(self, gammas: Floats, max_flights: int) -> NDArray[np.int64]:
        """Signatures (`model.orbits.ideal_cycles`) of the orbits from rest at each gamma, shape (m, SIGNATURE_SIZE)."""
        check_gamma(self.forcing, gammas)
        out = np.empty((len(gammas), ideal_cycles.SIGNATURE_SIZE), dtype=np.int64)
        turning = first_landing.turning_points(self.forcing)
        ideal_cycles.signatures(self.forcing.tones, turning, np.ascontiguousarray(gammas), 0.0, max_flights, out)
        return out

    def itinerary(self, gamma: float, max_flights: int) -> Itinerary:
        """Where the orbit from rest at ``gamma`` goes until it closes."""
        edge, n_windows = first_landing.edges(self.forcing, gamma)
        tau, phase, speed = np.empty((3, max_flights))
        index, threshold = np.empty((2, max_flights), dtype=np.int64)
        first, stop, _ = ideal_cycles.fly_until_closed(
            self.forcing.tones, gamma, edge, n_windows, 0.0, tau, phase, speed, index, threshold
        )
        landing = np.mod(phase[:stop] + tau[:stop] - edge[0], TWO_PI) + edge[0]
        return Itinerary(landing, index[:stop], np.zeros(stop, dtype=bool), first)

    def locked_family(self, gamma: float, window: int, after: float, n: int) -> tuple[bool, float, float, float, int]:
        """See `model.orbits.ideal_cycles.locked_family`."""
        turning = first_landing.turning_points(self.forcing)
        ok, miss, multiplier, half, code = ideal_cycles.locked_family(
            self.forcing.tones, turning, gamma, window, after, n
        )
        return ok, miss, multiplier, half, int(code)

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
