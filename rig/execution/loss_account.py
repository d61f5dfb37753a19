"""Account of a run's samples: the place of every frame among the samples that were played, and the clocks' tables.

A count that came short is taken at once; the rest is found in the looped-back drive
(`daq.clocks.sample_loss.LossDetector`). Recorded and declared lost samples add up to those that the device must have
given. The places that a device declares for its blocks are taken as they are. Where playing and recording have a clock
each, the back end reads them; every reading is written, and the map fitted to them at the end of a step.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from daq.clocks.clock_sync import fit_clock
from daq.clocks.loss_search import Searcher
from daq.clocks.sample_loss import LossDetector
from daq.files.tables import Block
from kernels.arrays import Floats
from rig.backends.base import TwoClocked
from rig.profile import Profile
from rig.programme.ramp import HighPass


class LossAccount:
    """The losses of one run.

    ``drive_column`` is that of the looped-back drive in a frame, ``scale`` its ``(volts_per_code, offset_v)``; a replay
    loops nothing back that was played now, so its drive is not compared. ``searcher`` runs the searches: at once, or in
    a thread for a device, which does not wait. ``lost_before`` samples were known to be missing before the last block,
    when it came.
    """

    def __init__(
        self, profile: Profile, drive_column: int, scale: tuple[float, float], searcher: Searcher | None = None
    ) -> None:
        rate_hz = profile.sampling.rate_hz
        # no whole number of cycles: one period shifted by a cycle looks like itself
        chunk = max(64, round(1.3 * rate_hz / profile.forcing.frequency_hz))
        self._finder = LossDetector(rate_hz, chunk, searcher)
        self._column = drive_column
        self._scale = scale if profile.backend.kind != "replay" else (0.0, 0.0)
        self.lag_samples = 0
        self.declares = False
        self.lost_before = 0
        self._capacitor = HighPass(profile.drive.highpass_hz, rate_hz)
        self._places: list[tuple[int, int]] = []
        self._frames_to = self._settled_to = 0
        self._short = self._settled_lost = 0
        self._gaps: list[tuple[int, int]] = []  # recorded index after each, and all samples lost before it

    def lags(self, lag_samples: int) -> None:
        """Set the latency of the loop-back of a device that declares its own losses."""
        self.lag_samples, self.declares = lag_samples, True
        self._finder.expect(lag_samples)

    @property
    def lost_samples(self) -> int:
        """Samples lost so far, settled or declared."""
        return self._finder.lost_samples

    @property
    def next_sample(self) -> int:
        """The played sample that the next frame belongs to."""
        return self._frames_to if self._places else self._finder.next_sample - self.lag_samples

    @property
    def settled_sample(self) -> int:
        """The played sample up to which losses are settled."""
        if self._places:
            return self._settled_to
        return self._finder.heard_samples + self._finder.lost_samples - self.lag_samples

    @property
    def expected_samples(self) -> int:
        """Samples that the device must have given; those that came short at the very end are in no gap."""
        return self._finder.next_sample + self._short

    def played(self, drive_v: Floats) -> None:
        """Append the samples that the device is about to play."""
        self._finder.played(self._capacitor(drive_v))

    def heard(self, block: Block, n_played: int) -> list[Block]:
        """Take in what came back for ``n_played`` samples; gives back the blocks that are settled, to be recorded."""
        if block.place is None and not self.declares:
            # frames without numbers: those that came short are missing somewhere before the next
            self._short += n_played - len(block.codes)
        if not len(block.codes):
            return []
        if block.place is None:
            block = replace(block, lost_before=self._short or block.lost_before)
            self._short = 0
            self.lost_before = block.lost_before
        else:
            self.lost_before = block.lost_before
            self._frames_to = block.place + len(block.codes)
            self._scale = (0.0, 0.0)
        volts = np.asarray(block.codes[:, self._column], np.float64) * self._scale[0] + self._scale[1]
        return self._noted(self._finder.heard(block, volts))

    def driven(self, block: Block, drive_v: Floats) -> Floats:
        """The drive under the frames of ``block``, which came back for ``drive_v``; it may lie behind."""
        if block.place is None and not self.lag_samples:
            return drive_v
        first = self.next_sample - len(block.codes) if block.place is None else block.place
        return self._finder.piece(first, first + len(block.codes))

    def flush(self) -> list[Block]:
        """The blocks that still waited, at the end."""
        return self._noted(self._finder.flush())

    def recorded(self, played: int) -> int:
        """The recorded index of a played sample (of the next one recorded, where it was lost)."""
        if self._places:
            # as `recorded`, by the places that the blocks declare
            k = max(bisect_right(self._places, played, key=itemgetter(1)) - 1, 0)
            first, place = self._places[k]
            index = max(first + played - place, 0)
            return min(index, self._places[k + 1][0]) if k + 1 < len(self._places) else index
        played += self.lag_samples
        lost = 0
        for at, lost_in_all in self._gaps:
            if played >= at + lost_in_all:
                lost = lost_in_all
            elif played > at + lost:
                return at
        return played - lost

    def counted(self, recorded: int) -> int:
        """A recorded index with the samples lost before it counted."""
        return recorded + max((lost for at, lost in self._gaps if at <= recorded), default=0)

    def _noted(self, blocks: list[Block]) -> list[Block]:
        """Remember where gaps lie: a loss shifts recorded against played samples."""
        for block in blocks:
            if block.place is not None:
                shift = block.place - block.first_sample
                if not self._places or shift != self._places[-1][1] - self._places[-1][0]:
                    self._places.append((block.first_sample, block.place))
                self._settled_to = block.place + len(block.codes)
            if block.lost_before:
                self._settled_lost += block.lost_before
                self._gaps.append((block.first_sample, self._settled_lost))
        return blocks


class ClockLog:
    """The clock tables of one run; ``rate`` is played samples a frame, less one, by the last map (0 before it)."""

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
