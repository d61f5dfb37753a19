"""Tones of a plate that gives way under the ball, as if nothing were masked: for the control loop and the analysis.

Masked after each impact, a fit misses the same part of every cycle. Where the ball's load bends the plate, that part
differs from the rest. So the load's share in the motion is fitted, too, and put back where it was masked.

References
----------
R. Frisch and F. V. Waugh, Econometrica 1, 387 (1933): the share follows from what the tones leave of both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from daq.lock_in import LockIn, ToneFit
from kernels.arrays import Complexes, Floats


@dataclass(frozen=True)
class Load:
    """Response of the plate to the ball's load: sums over values of the residuals of acceleration and load."""

    cross: float = 0.0
    load_square: float = 0.0
    square: float = 0.0
    n: int = 0

    def __add__(self, other: Load) -> Load:
        return Load(
            self.cross + other.cross, self.load_square + other.load_square, self.square + other.square, self.n + other.n
        )

    def share(self) -> tuple[float, float]:
        """Acceleration for a unit of load, and its standard uncertainty; nothing where it does not stand out."""
        if self.load_square <= 0.0:
            return 0.0, 0.0
        share = self.cross / self.load_square
        left = max(self.square - share * self.cross, 0.0)  # of the acceleration, once the load's share is taken out
        sigma = math.sqrt(left / (self.n * self.load_square))
        # a share that does not stand out of its uncertainty is not corrected for
        return (share, sigma) if abs(share) > 5.0 * sigma else (0.0, 0.0)


@dataclass(frozen=True)
class LoadedTones:
    """Normal equations of the unmasked values and of all, and the part of each in which the ball touches the plate.

    The first channel is the plate's acceleration, in any unit; ``gravity`` is g in that unit. The load is the
    acceleration of the touching ball over its weight's, ``motion + gravity``.
    """

    unmasked: LockIn
    whole: LockIn
    unmasked_contact: LockIn
    whole_contact: LockIn
    gravity: float

    @classmethod
    def of_sorts(cls, sums: LockIn, gravity: float) -> Self:
        """From sums of four sorts: 0 unmasked, 2 masked, and one more where the ball touches the plate."""
        return cls(sums.part([0, 1]), sums.part([0, 1, 2, 3]), sums.part([1]), sums.part([1, 3]), gravity)

    def __add__(self, other: Self) -> Self:
        return type(self)(
            self.unmasked + other.unmasked,
            self.whole + other.whole,
            self.unmasked_contact + other.unmasked_contact,
            self.whole_contact + other.whole_contact,
            self.gravity,
        )

    def _load_columns(self, fit: ToneFit) -> Floats:
        """The load, as far as the ball touches, in the columns of the normal equations."""
        return np.concatenate([[self.gravity], np.column_stack([fit.amplitudes.real, fit.amplitudes.imag]).ravel()])

    def load(self) -> Load:
        """Sums for the load's share in the motion; raises ``ValueError`` where the tones cannot be distinguished.

        Where hardly any of the contact is unmasked, the last of a ringing would be taken for a load: none is then seen.
        """
        # where less than this part of the contact is unmasked, load and tones cannot be distinguished
        if self.unmasked_contact.gram[0, 0] < 0.1 * self.whole_contact.gram[0, 0]:
            return Load()
        x = self.unmasked.solve(0)
        columns = self._load_columns(x)
        common = self.unmasked_contact.gram @ columns
        # Frisch and Waugh: what the tones explain of the load is taken out before its share is fitted
        tones_of_load = self.unmasked.inverse() @ common
        square = float(columns @ common - tones_of_load @ common)
        cross = float(columns @ self.unmasked_contact.rhs[:, 0] - tones_of_load @ self.unmasked.rhs[:, 0])
        freedom = x.n - self.unmasked.gram.shape[0]
        return Load(cross, max(square, 0.0), x.rms**2 * freedom, x.n)

    def solve(self, load: Load | None = None) -> tuple[Complexes, Floats]:
        """Amplitudes of all tones of a motion that no mask has cut, and their standard uncertainties.

        Raises `ValueError` where the values cannot distinguish the tones.

        ``load``: sums from which the load's share follows; by default those of these values.
        """
        x = self.unmasked.solve(0)
        share, share_sigma = (self.load() if load is None else load).share()
        if share == 0.0:
            return x.amplitudes, x.amplitude_sigma()
        columns = self._load_columns(x)
        # tones of the load over all values, less those over the unmasked ones: what the mask took away
        missing = self.whole.inverse() @ self.whole_contact.gram @ columns
        missing = missing - self.unmasked.inverse() @ self.unmasked_contact.gram @ columns
        tones = missing[1::2] + 1j * missing[2::2]
        return x.amplitudes + share * tones, np.hypot(x.amplitude_sigma(), np.abs(tones) * share_sigma / math.sqrt(2.0))
