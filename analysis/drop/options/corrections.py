"""Corrections by hand: what a person leaves out of a file, adds to it, or says about its picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Corrections:
    """What a person leaves out, adds, or says about the picture.

    An impact that is moved is one left out and one added.

    Attributes
    ----------
    from_s, until_s : float or None
        Part of the file that is used, in its own time.
    ignore_s : tuple of float
        Times of impacts (or frames) to be left out.
    add_s : tuple of float
        Times of impacts that were not found.
    region : (left, top, right, bottom) or None
        Part of the picture, pixels.
    axis_deg : float or None
        Direction of the fall in the picture, degrees right of down; None finds it.
    """

    from_s: float | None = None
    until_s: float | None = None
    ignore_s: tuple[float, ...] = ()
    add_s: tuple[float, ...] = ()
    region: tuple[int, int, int, int] | None = None
    axis_deg: float | None = None

    def keeps(self, times: Array, reach_s: float) -> NDArray[np.bool_]:
        """Which of ``times`` are used; each ignored time takes the nearest within ``reach_s``."""
        low = -np.inf if self.from_s is None else self.from_s
        high = np.inf if self.until_s is None else self.until_s
        kept = (times >= low) & (times <= high)
        for when in self.ignore_s:
            off = np.abs(times - when)
            if len(off) and off.min() <= reach_s:
                kept &= off > off.min()
        return np.asarray(kept)


NOTHING = Corrections()
