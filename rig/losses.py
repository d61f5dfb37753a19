"""Where every frame of a run belongs among the samples that were played, losses counted.

The rule kept here: a count that came short is believed at once, and the looped-back drive is asked about the rest
(`daq.clock.LossFinder`). What is recorded and what is declared as lost add up to what the device must have given.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq.block import Block
from daq.clock import LossFinder
from rig.forcing import Floats
from rig.profile import Profile

CHUNK_CYCLES = 1.3  # of the forcing, looked at together
LEAST_CHUNK = 64  # samples


class LossAccount:
    """The losses of one run.

    Parameters
    ----------
    profile
        Rate and forcing; a replay loops nothing back that was played now, so its drive is not asked.
    drive_column
        Column of the looped-back drive in a frame.
    scale
        Its ``(volts_per_code, offset_v)``.
    """

    def __init__(self, profile: Profile, drive_column: int, scale: tuple[float, float]) -> None:
        rate_hz = profile.sampling.rate_hz
        chunk = max(LEAST_CHUNK, round(CHUNK_CYCLES * rate_hz / profile.forcing.frequency_hz))
        self._finder = LossFinder(rate_hz, chunk)
        self._column = drive_column
        self._scale = scale if profile.backend.kind != "replay" else (0.0, 0.0)
        self._short = self._settled_lost = 0
        self._losses: list[tuple[int, int]] = []

    @property
    def lost_samples(self) -> int:
        """Samples lost so far, settled or declared."""
        return self._finder.lost_samples

    @property
    def next_sample(self) -> int:
        """The played sample that the next frame belongs to."""
        return self._finder.next_sample

    @property
    def settled_sample(self) -> int:
        """The played sample up to which losses are settled."""
        return self._finder.heard_samples + self._finder.lost_samples

    @property
    def expected_samples(self) -> int:
        """Samples that the device must have given; those that came short at the very end are in no gap."""
        return self._finder.next_sample + self._short

    def played(self, drive_v: Floats) -> None:
        """Say what the device is about to play."""
        self._finder.played(drive_v)

    def heard(self, block: Block, n_played: int) -> list[Block]:
        """Take in what came back for ``n_played`` samples; gives back the blocks that are settled, to be recorded."""
        self._short += n_played - len(block.codes)
        if not len(block.codes):
            return []
        block = replace(block, lost_before=self._short or block.lost_before)
        self._short = 0
        volts = np.asarray(block.codes[:, self._column], np.float64) * self._scale[0] + self._scale[1]
        return self._noted(self._finder.heard(block, volts))

    def flush(self) -> list[Block]:
        """The blocks that still waited, at the end."""
        return self._noted(self._finder.flush())

    def recorded(self, played: int) -> int:
        """The recorded index of a played sample (of the next one recorded, where it was lost)."""
        lost = 0
        for first_played, lost_in_all in self._losses:
            if played >= first_played:
                lost = lost_in_all
            elif played > first_played - (lost_in_all - lost):
                return first_played - lost_in_all
        return played - lost

    def _noted(self, blocks: list[Block]) -> list[Block]:
        """Remember where gaps lie: a loss shifts recorded against played samples."""
        for block in blocks:
            if block.lost_before:
                self._settled_lost += block.lost_before
                self._losses.append((block.first_sample + self._settled_lost, self._settled_lost))
        return blocks
