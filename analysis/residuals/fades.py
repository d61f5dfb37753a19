"""The plate while the drive fades from step to step: between the motions of both steps, as the drive's weight has it.

A plate mode rings on from step to step. Flights in the fade strike it, too: how hard depends on the plate's motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from daq.recording import Recording

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Fades:
    """Fades into each step of a recording, arrays (m,): when they begin, and how long they last."""

    begin_s: Array
    length_s: Array

    @classmethod
    def of(cls, recording: Recording) -> Self:
        """From the table of steps."""
        steps, rate_hz = recording.steps, recording.rate_hz
        return cls(steps["first_sample"] / rate_hz, steps["fade_samples"] / rate_hz)

    def before_half(self, step: Ints, time_s: Array) -> NDArray[np.bool_]:
        """Whether times in steps, (n,) each, lie before the half of the fade: the plate moves as in the step before."""
        half_s = np.append(self.begin_s + 0.5 * self.length_s, np.inf)
        return np.asarray((step > 0) & (time_s < half_s[np.minimum(step, len(half_s) - 1)]))

    def others(self, step: Ints, time_s: Array) -> tuple[Ints, Array]:
        """The other step of the fade in which each time lies, -1 for rest, and the share of its motion, (n,) each.

        ``step`` is the one whose motion is taken for the plate's; no share outside of fades. The weight of the new step
        goes as ``x^2 (3 - 2 x)`` with the part x of the fade that is over.
        """
        if not len(self.begin_s):
            return np.full(len(step), -1, dtype=np.int64), np.zeros(len(step))
        into = np.maximum(np.searchsorted(self.begin_s, time_s, side="right") - 1, 0)
        length_s = self.length_s[into]
        part = np.clip((time_s - self.begin_s[into]) / np.where(length_s > 0.0, length_s, 1.0), 0.0, 1.0)
        new = np.where(length_s > 0.0, part * part * (3.0 - 2.0 * part), 1.0)
        other = np.where(step == into, into - 1, into)
        share = np.where(step == into, 1.0 - new, np.where(step == into - 1, new, 0.0))
        return other, np.where((share > 0.0) & (share < 1.0), share, 0.0)
