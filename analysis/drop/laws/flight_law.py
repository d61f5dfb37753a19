"""One flight above a floor at rest, in closed form: gravity, Coulomb friction, quadratic air drag.

Every relation is exact (no time stepping). Going up the ball is slowed by ``g (1 + f)`` plus
``k v^2``; coming down it is driven by ``g (1 - f)`` less ``k v^2`` (Rayleigh drag; Coulomb 1785). All functions are
vectorised, work in any consistent units, and go over into the parabola as ``f`` and ``k`` go to zero. Decision 12.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

Numbers = Any  # a float or an array of them: everything here broadcasts


@dataclass(frozen=True)
class FlightLaw:
    """Gravity with friction and drag; each may be an array (one law for each draw of a fit), then all broadcast."""

    g_mps2: Numbers  # local gravity, m/s^2 (or any length per time squared)
    friction: Numbers = 0.0  # Coulomb friction over the weight, ``0 <= f < 1``: at 1 the ball would hang on its rod
    drag_per_m: Numbers = 0.0  # ``k`` of ``-k |v| v``, 1/m

    @cached_property
    def _k(self) -> Numbers:
        """The drag; where there is none, so little that what is left is a parabola to its last digits."""
        return np.where(np.abs(self.drag_per_m) < 1e-12, 1e-12, self.drag_per_m)

    @cached_property
    def up_mps2(self) -> Numbers:
        """Deceleration on the way up at zero speed."""
        return self.g_mps2 * (1.0 + self.friction)

    @cached_property
    def down_mps2(self) -> Numbers:
        """Acceleration on the way down at zero speed."""
        return self.g_mps2 * (1.0 - self.friction)

    def apex_m(self, speed_mps: Numbers) -> Numbers:
        """Height reached from take-off at ``speed_mps``."""
        v = np.asarray(speed_mps, dtype=np.float64)
        return np.log1p(self._k * v * v / self.up_mps2) / self._k / 2.0

    def landing_speed_mps(self, height_m: Numbers) -> Numbers:
        """Speed after a fall from rest through ``height_m``."""
        h = np.maximum(np.asarray(height_m, dtype=np.float64), 0.0)
        return np.sqrt(self.down_mps2 / self._k * -np.expm1(-2.0 * self._k * h))

    def fall_m(self, speed_mps: Numbers) -> Numbers:
        """Height of a fall from rest that ends at ``speed_mps`` (infinite at the terminal speed and beyond)."""
        v = np.asarray(speed_mps, dtype=np.float64)
        lost = self._k * v * v / self.down_mps2
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(lost < 1.0, -np.log1p(-lost) / (2.0 * self._k), np.inf)

    def rise_s(self, speed_mps: Numbers) -> Numbers:
        """Time from take-off to the apex."""
        v = np.asarray(speed_mps, dtype=np.float64)
        return np.arctan(v * np.sqrt(self._k / self.up_mps2)) / np.sqrt(self._k * self.up_mps2)

    def fall_s(self, height_m: Numbers) -> Numbers:
        """Time of a fall from rest through ``height_m``."""
        h = np.maximum(np.asarray(height_m, dtype=np.float64), 0.0)
        x = np.expm1(self._k * h)  # acosh(1 + x) without the cancellation of acosh near 1
        return np.log1p(x + np.sqrt(x * (x + 2.0))) / np.sqrt(self._k * self.down_mps2)

    def duration_s(self, speed_mps: Numbers) -> Numbers:
        """Flight time from take-off at ``speed_mps`` to the next landing."""
        return self.rise_s(speed_mps) + self.fall_s(self.apex_m(speed_mps))

    def return_speed_mps(self, speed_mps: Numbers) -> Numbers:
        """Speed at the next landing, of a flight that took off at ``speed_mps``."""
        return self.landing_speed_mps(self.apex_m(speed_mps))

    def takeoff_speed_mps(self, duration_s: Numbers) -> Numbers:
        """Take-off speed of a flight of ``duration_s``: Newton on `duration_s`, which grows with the speed."""
        t = np.asarray(duration_s, dtype=np.float64)
        v = t / (1.0 / self.up_mps2 + 1.0 / np.sqrt(self.up_mps2 * self.down_mps2))
        for _ in range(12):
            top = self.apex_m(v)
            u = np.maximum(self.landing_speed_mps(top), 1e-12)
            growth = 1.0 + self._k * v * v / self.up_mps2
            slope = (1.0 + v / u) / (self.up_mps2 * growth)
            moved = np.maximum(v + (t - self.rise_s(v) - self.fall_s(top)) / slope, 0.5 * v)
            settled = np.all(np.abs(moved - v) <= 1e-12 * v)
            v = moved
            if settled:
                break
        return v

    def drop_m(self, since_apex_s: Numbers) -> Numbers:
        """Distance below the apex ``since_apex_s`` after it (negative: before it); the drag may be below zero."""
        t, k = np.asarray(since_apex_s, dtype=np.float64), self._k
        along = np.where(t < 0.0, self.up_mps2, self.down_mps2)
        x = np.sqrt(np.maximum(np.abs(k) * along, 0.0)) * np.abs(t)  # no gravity below zero, as a step of a fit may try
        # log cosh where the ball is slowed, - log cos where it speeds up (to the pole, where no flight gets), both
        # without the cancellation near 0
        slowed = 0.5 * np.log1p(np.sinh(np.minimum(x, 300.0)) ** 2)
        way: Numbers = np.where((t >= 0.0) == (k > 0.0), slowed, -0.5 * np.log1p(-(np.sin(np.minimum(x, 1.5)) ** 2)))
        return way / np.abs(k)

    def velocity_mps(self, since_apex_s: Numbers) -> Numbers:
        """Upward velocity ``since_apex_s`` after the apex."""
        t, k = np.asarray(since_apex_s, dtype=np.float64), self._k
        rise = np.minimum(np.sqrt(k * self.up_mps2) * -np.minimum(t, 0.0), 1.5)
        fall = np.sqrt(k * self.down_mps2) * np.maximum(t, 0.0)
        up = np.sqrt(self.up_mps2 / k) * np.tan(rise)
        return np.where(t < 0.0, up, -np.sqrt(self.down_mps2 / k) * np.tanh(fall))
