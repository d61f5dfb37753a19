"""Corrections by hand: what a person leaves out of a file, adds to it, or says about its picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kernels.arrays import Bools, Floats

Progress = Callable[[str, int, int], None]  # what is being done, how much of it is done, and of how much


@dataclass(frozen=True)
class Corrections:
    """Parts that a person leaves out or adds, and what the picture is said to show.

    An impact that is moved is one left out and one added.
    """

    from_s: float | None = None  # begin of the part that is used, in the file's own time
    until_s: float | None = None  # its end
    ignore_s: tuple[float, ...] = ()  # times of impacts (or frames) to be left out
    add_s: tuple[float, ...] = ()  # times of impacts that were not found
    region: tuple[int, int, int, int] | None = None  # (left, top, right, bottom) of the picture, pixels
    axis_deg: float | None = None  # direction of the fall in the picture, degrees right of down; None finds it

    def keeps(self, times: Floats, reach_s: float) -> Bools:
        """Flags of those ``times`` (n,) that are used; each ignored time takes out the nearest within ``reach_s``."""
        used = times >= (-np.inf if self.from_s is None else self.from_s)
        used &= times <= (np.inf if self.until_s is None else self.until_s)
        for when in self.ignore_s:
            off = np.abs(times - when)
            if len(off) and off.min() <= reach_s:
                used &= off > off.min()
        return np.asarray(used)


NOTHING = Corrections()
