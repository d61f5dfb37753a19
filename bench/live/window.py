"""The present step of a run in memory, as a recording that the analysis reads like any other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import BLOCK_DTYPE, NOTE_DTYPE, Block, step_row
from daq.recording import Recording
from daq.recording.reader import gaps_of
from daq.setup.setup import Setup


class StepWindow(Recording):
    """One step's frames; sample 0 is the step's first.

    Parameters
    ----------
    setup
        The measuring part of the run's profile.
    channels, scales
        Names of a frame's columns, and ``(volts_per_code, offset_v)`` of each.
    step
        The step's row, as planned or as driven.
    blocks
        Frames from the step's first on, in order.
    """

    def __init__(
        self,
        setup: Setup,
        channels: Sequence[str],
        scales: Mapping[str, Sequence[float]],
        step: Mapping[str, Any],
        blocks: Sequence[Block],
    ) -> None:
        self.path = Path("the present step")
        self.setup, self.rate_hz, self.channels = setup, setup.sampling.rate_hz, tuple(channels)
        self.frames, self.damage, self.attrs, self.stored = None, (), {}, {}
        self._scales = {name: list(scale) for name, scale in scales.items()}
        first = int(step["first_sample"])
        own = [_from(block, first) for block in blocks if block.first_sample + len(block.codes) > first]
        self._codes = np.concatenate([block.codes for block in own]) if own else np.zeros((0, len(channels)), np.int16)
        self._codes = self._codes[: int(step["n_samples"])]
        self.n_samples = len(self._codes)
        self.steps = step_row({**step, "first_sample": 0})
        self.steps["n_samples"] = self.n_samples
        self.blocks = np.zeros(len(own), BLOCK_DTYPE)
        lengths = np.array([len(block.codes) for block in own], np.int64)
        self.blocks["first_sample"], self.blocks["n_samples"] = np.cumsum(lengths) - lengths, lengths
        self.blocks["flags"] = [block.flags for block in own]
        self.blocks["lost_before"] = [block.lost_before if i else 0 for i, block in enumerate(own)]
        self.gaps, self.notes, self.side = gaps_of(self.blocks), np.zeros(0, NOTE_DTYPE), {}

    def codes(
        self, channel: str, start: int = 0, stop: int | None = None, out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """As `Recording.codes`."""
        codes = np.ascontiguousarray(self._codes[start:stop, self.channels.index(self._known(channel))])
        if out is None:
            return codes
        out[: len(codes)] = codes
        return out[: len(codes)]


def _from(block: Block, first: int) -> Block:
    """The part of a block from sample ``first`` of the recording on."""
    cut = first - block.first_sample
    return block if cut <= 0 else Block(first, block.codes[cut:], block.flags)
