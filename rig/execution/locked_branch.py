"""The locked cycle over gamma, as a prediction gives it: what a ball is held on where it is not stable.

A ball that lands at phase ``p`` of the drive and is launched at once lands a period later at ``p* + mu (p - p*)``, on
the cycle where ``p = p*``. A drive greater by the part ``e`` and ahead by the phase ``u``, both from the launch on,
moves that landing by ``(1 - mu) (p*' e - u)``, where ``p*'`` is the derivative of ``p*`` by the logarithm of gamma: the
cycle of the changed drive is another one, and the deviation from it grows by the same multiplier.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kernels.arrays import Floats


@dataclass(frozen=True)
class LockedBranch:
    """Landing phase (radians, from the zero of the first tone's sine) and multiplier of the locked cycle, (n,) each.

    ``gamma`` ascends; the branch is known between its ends.
    """

    gamma: Floats
    phase: Floats
    multiplier: Floats

    def at(self, gamma: float) -> Point | None:
        """The cycle at ``gamma``; None outside of what is known."""
        if not self.gamma[0] <= gamma <= self.gamma[-1]:
            return None
        slopes = np.gradient(self.phase, np.log(self.gamma))
        phase, multiplier, slope = (
            float(np.interp(gamma, self.gamma, values)) for values in (self.phase, self.multiplier, slopes)
        )
        return Point(phase, multiplier, slope)


@dataclass(frozen=True)
class Point:
    """The locked cycle at one gamma: landing phase, multiplier, and the phase's derivative by log gamma."""

    phase: float
    multiplier: float
    slope: float

    def next_landing(self, phase: float, part: float, ahead: float) -> float:
        """Phase of the landing after one at ``phase``, the drive greater by ``part`` and ``ahead`` by a phase."""
        p = self
        return p.phase + p.multiplier * (phase - p.phase) + (1.0 - p.multiplier) * (p.slope * part - ahead)

    def response(self, weight: float) -> Floats:
        """What the next landing gains by a correction of both kinds, (2,): each for 1 of the drive's rms.

        ``weight`` is the change of the drive, in parts of its rms, for each radian of phase.
        """
        return (1.0 - self.multiplier) * np.array([self.slope, -1.0 / weight])

    @property
    def pole(self) -> float:
        """What is to be left of a deviation a cycle later: with the least corrections, 1 over the multiplier."""
        size = abs(self.multiplier)
        # near mu = -1 the least correction would leave all of a deviation: at most 0.7 of it are left
        return math.copysign(min(size, 1.0 / size, 0.7), self.multiplier) if size > 0.0 else 0.0


SLOWEST = 0.7  # largest part of a deviation left a cycle later: near mu = -1 the least correction would leave all
