"""What a run writes down of two clocks: every raw reading, and at the end of a step the map fitted to them.

Nothing is measured again. The back end reads the clocks; this only passes on what is new.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from daq.clocks.clock_sync import fit_clock
from rig.backends.base import TwoClocked


class ClockLog:
    """The clock tables of one run.

    Attributes
    ----------
    rate : float
        Played samples a frame, less one, by the last map; 0 before the first.
    """

    def __init__(self, backend: TwoClocked) -> None:
        self.rate = 0.0
        self._backend = backend
        self._written = 0
        self._mapped = -1

    def rows(self, at: int) -> Iterator[tuple[str, NDArray[np.void]]]:
        """New readings, and the map at frame ``at`` (lost ones counted) where they reach it: ``(table, rows)``."""
        readings = self._backend.readings
        new = readings[self._written :]
        if len(new):
            self._written = len(readings)
            yield "clock_readings", new
        if len(readings) < 2 or at <= self._mapped or readings["recorded_sample"][-1] < at:
            return
        # what lies further back says nothing of the clocks' rate now
        node = fit_clock(readings[-600:], np.array([at]))
        self._mapped, self.rate = at, float(node["rate"][0])
        yield "clock_map", node
