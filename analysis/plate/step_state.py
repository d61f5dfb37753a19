"""State of one step's fit while the recording streams by: block means, normal equations, amplitudes within windows."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from analysis.plate.fit_mask import FitIntervals
from analysis.plate.mains_lines import MainsLine
from daq.instrument.saturation import Ends
from daq.lock_in import LockIn, ToneFit
from kernels.arrays import Bools, Complexes, Floats, Integers

HARMONICS = 5
MASK_PARTS = (0.25, 0.35, 0.5, 0.7, 1.0)  # lengths of the masks after an impact, as parts of the longest
N_MASK_LEVELS = len(MASK_PARTS) + 1  # a block's mask level is the number of masks that it is clear of
CONTACT, NEITHER, FLIGHT = range(3)
N_BLOCK_CLASSES = 3 * N_MASK_LEVELS


def multiples_of(forcing: tuple[int, ...]) -> tuple[int, ...]:
    """Multiples that are fitted to a ``forcing`` of some: the first tone's to `HARMONICS`, those of others to 3."""
    return tuple(sorted(set(range(1, HARMONICS + 1)) | {m * k for m in forcing for k in (1, 2, 3)}))


@dataclass(frozen=True)
class Span:
    """Consecutive block means from block ``first`` on (counted from sample 0, lost samples included).

    ``values`` (n, 2) are accelerometer and drive in volts. ``block_class`` (n,) is the block's place (contact,
    neither, flight) times `N_MASK_LEVELS`, plus its mask level.
    """

    first: int
    values: Floats
    block_class: npt.NDArray[np.int8]

    @property
    def last(self) -> int:
        """One past the last block."""
        return self.first + len(self.values)

    def clear(self, mask_level: int) -> Bools:
        """Blocks outside the chosen mask, (n,)."""
        return self.block_class % N_MASK_LEVELS >= mask_level


@dataclass(frozen=True)
class ChunkFit:
    """Slow residual and windowed amplitudes of one chunk of a step, in volts."""

    slow_s: Floats  # times of the slow motion, (s,)
    slow: Floats  # mean residual of the accelerometer there, (s,); NaN where all is masked
    time_s: Floats  # middle of each window of a few cycles, (w,)
    amplitudes: Complexes  # (w, tones, channels)
    spread: Floats  # uncertainty of an amplitude in units of its channel's noise, (w, tones)
    noise: Floats  # residual rms within windows: slow amplitude modulation does not count, (channels,)
    fits: tuple[ToneFit, ToneFit]  # the step's fit of accelerometer and of drive when the chunk was closed
    intervals: FitIntervals  # times outside the mask
    # accelerometer less all tones but a mains line, demodulated at it and summed over bins of `BIN_S`, (b, lines)
    beats: Complexes
    near: Floats  # noise near each mains line, see `noise_near`, (lines, 2)


@dataclass
class PlannedStep:
    """A step's hold as the step table has it: its number, first tone, the multiples driven, its beginning."""

    step: int
    nominal_hz: float
    forcing: tuple[int, ...]
    first_sample: int


@dataclass
class StepState(PlannedStep):
    """Accumulated state of one step: open spans, tones, normal equations and closed chunks.

    ``first_codes`` are its first accelerometer samples as stored, where they came in one piece; ``ends`` the codes at
    which the accelerometer is at its end, where blocks that reach them are masked. No harmonic beyond ``most_multiple``
    is fitted.
    """

    last_sample: int
    hold_s: float
    spans: list[Span] = field(default_factory=list)
    blocks: int = 0
    frequency_hz: float = np.nan
    frequency_uncertainty_hz: float = np.inf
    most_multiple: float = np.inf
    multiples: tuple[int, ...] = ()
    mains: tuple[MainsLine, ...] = ()
    lock_in: LockIn | None = None
    mask_level: int = N_MASK_LEVELS
    chunks: list[ChunkFit] = field(default_factory=list)
    first_codes: npt.NDArray[Any] | None = None
    ends: Ends | None = None

    @property
    def rows(self) -> list[int]:
        """Rows of the forcing's tones among the fitted ones."""
        return [self.multiples.index(m) for m in self.forcing if m in self.multiples]

    def clear_classes(self, places: tuple[int, ...] = (CONTACT, NEITHER, FLIGHT)) -> Integers:
        """Block classes of the given places outside the chosen mask."""
        return np.array(
            [p * N_MASK_LEVELS + level for p in places for level in range(self.mask_level, N_MASK_LEVELS)],
            dtype=np.int64,
        )
