"""Rows that are missing in a file without times, by jumps of the forcing's phase."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from daq.steps.find_steps import SAME_FREQUENCY, FoundStep
from daq.steps.forcing_detection import Read
from kernels.arrays import Complexes, Floats, Integers


def lost_rows(read: Read, found: list[FoundStep], rate_hz: float) -> Integers:
    """Places where rows are missing: ``(k, 3)``, row before which, how many, and their uncertainty.

    A forcing that runs on through the steps keeps its phase at most of their borders; where it jumps by what a number
    of samples explains in all tones, these are missing. Whole cycles more leave no trace.

    ``read`` gives volts of samples ``a .. b`` of the channel in which the steps were found.
    """
    borders = [
        (last, step)
        for last, step in pairwise(found)
        if abs(last.frequency_hz - step.frequency_hz) < SAME_FREQUENCY * step.frequency_hz
    ]
    if len(borders) < 4:
        return np.zeros((0, 3), np.int64)
    jumps = [_Jump.at(*border, rate_hz) for border in borders]
    # where the phase jumps at most borders, the forcing starts anew in every step and says nothing
    usual_rad = float(np.median([np.abs(jump.angles(np.zeros(1))).max() for jump in jumps]))
    if usual_rad > 0.03:
        return np.zeros((0, 3), np.int64)
    out = []
    for (last, step), jump in zip(borders, jumps, strict=True):
        # phases agree to this, at best
        lost = jump.lost(max(usual_rad, 1e-4))
        if lost is not None:
            out.append((jump.place(read, last, step, lost[0]), *lost))
    return np.array(out, np.int64).reshape(-1, 3)


@dataclass(frozen=True)
class _Jump:
    """Phases of the tones before and after a border of two steps."""

    before: Complexes  # unit phasors of the tones at sample 0 by the mean frequency, (k,)
    after: Complexes  # the same, (k,)
    sigma_rad: Floats  # uncertainty of the phase between them, (k,)
    turns: Floats  # cycles of each tone in a sample, (k,)

    @classmethod
    def at(cls, last: FoundStep, step: FoundStep, rate_hz: float) -> Self:
        """The jump between two steps; each is carried to their border by its own frequency."""
        border_s = 0.5 * (last.stop + step.hold) / rate_hz
        mean_hz = 0.5 * (last.tones.frequencies_hz + step.tones.frequencies_hz)
        units, variance = [], np.zeros(len(mean_hz))
        for one in (last, step):
            tones = one.tones
            carried = tones.amplitudes * np.exp(2j * np.pi * (tones.frequencies_hz - mean_hz) * border_s)
            units.append(carried / np.abs(carried))
            away_s = abs(border_s - 0.5 * (one.hold + one.stop) / rate_hz)
            slope = 2.0 * np.pi * away_s * one.frequency_sigma_hz * tones.frequencies_hz / one.frequency_hz
            variance += (tones.amplitude_sigma() / np.abs(tones.amplitudes)) ** 2 + slope**2
        return cls(units[0], units[1], np.sqrt(variance), mean_hz / rate_hz)

    def angles(self, lost: Floats) -> Floats:
        """Jump of each tone's phase that is left if so many samples (n,) are missing, (n, k)."""
        advanced = self.before * np.exp(2j * np.pi * np.outer(lost, self.turns))
        return np.asarray(np.angle(self.after / advanced))

    def lost(self, sure_rad: float) -> tuple[int, int] | None:
        """Number of samples missing and its uncertainty; None where none are, or no number explains all tones."""
        sigma_rad = np.hypot(self.sigma_rad, sure_rad)
        # a loss is a jump by more than its uncertainty, and by more than a sample and a half in every tone
        least = np.maximum(5.0 * sigma_rad, 2.0 * np.pi * 1.5 * self.turns)
        if np.all(np.abs(self.angles(np.zeros(1))) < least):
            return None
        counts = np.arange(1.0, 1.0 / self.turns.min())
        misfit = np.abs(self.angles(counts)).max(axis=1)
        best = int(np.argmin(misfit))
        sigma = float(np.min(sigma_rad / self.turns)) / (2.0 * np.pi)
        return (int(counts[best]), math.ceil(3.0 * sigma)) if misfit[best] < least.max() else None

    def place(self, read: Read, last: FoundStep, step: FoundStep, lost: int) -> int:
        """Sample before which they are missing: the old phase fits best up to it, the new one from it on."""
        cycle = round(1.0 / self.turns.min())
        start, stop = max(last.stop - 2 * cycle, last.hold), min(step.hold + 2 * cycle, step.stop)
        x, index = read(start, stop), np.arange(start, stop)
        x = x - x.mean()
        models = np.zeros((2, len(x)))
        here = index - start
        ends = (here - cycle, here), (here, here + cycle)  # windows on one side each
        for model, carried, window in zip(models, (0, lost), ends, strict=True):
            low, high = (np.clip(end, 0, len(x)) for end in window)
            for u, turns in zip(self.before, self.turns, strict=True):
                wave = np.exp(2j * np.pi * turns * index)
                sums = np.concatenate([[0.0], np.cumsum(x * wave.conj())])
                size = 2.0 * np.abs(sums[high] - sums[low]) / np.maximum(high - low, 1)
                model += size * (u * np.exp(2j * np.pi * turns * carried) * wave).real
        misfit = (x - models) ** 2
        before = np.concatenate([[0.0], np.cumsum(misfit[0])])
        after = np.concatenate([np.cumsum(misfit[1][::-1])[::-1], [0.0]])
        return int(start + np.argmin(before + after))
