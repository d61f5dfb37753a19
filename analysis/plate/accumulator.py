"""Accelerometer and drive of each step folded into tone fits, while the recording streams by.

The rule kept here: samples are averaged over blocks much shorter than a period (the blocks' gain and delay are taken
out exactly), blocks that an impact touches are left out, and each block counts as contact, as flight or as neither.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from analysis.plate import step_fit
from analysis.plate.mains_lines import LOBE, MAINS_HZ, MainsLine, heard_hz, line_of, lines_apart, moved
from analysis.plate.motion import StepPlate
from analysis.signals.stream import Piece, block_means
from daq.lock_in import LockIn, ToneFit
from daq.recording import Recording

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

HARMONICS = 5
BLOCK_S = 1e-3  # longest block of samples averaged before the fit
LEAD_S = 2e-4  # masked before an impact
SURELY_CLEAR = 0.85  # of a step, above which no mask can do harm
MOST_INFLATED = 1.6  # of a tone's uncertainty, by the mask
PARTS = (0.25, 0.35, 0.5, 0.7, 1.0)  # of the mask's length, tried from the longest down
N_MASK_LEVELS = len(PARTS) + 1  # by how many of the masks a block is clear of
CONTACT, NEITHER, FLIGHT = range(3)
CHAPTER = 1 << 17  # means kept in memory before they are folded in


@dataclass(frozen=True)
class Span:
    """Consecutive block means: block ``first`` (counted from sample 0, lost samples included) and on.

    ``values`` (n, 2) are accelerometer and drive in volts; ``sort`` is the block's place (contact, neither, flight)
    times `N_MASK_LEVELS` plus how many of the masks it is clear of.
    """

    first: int
    values: Floats
    sort: npt.NDArray[np.int8]


@dataclass
class StepState:
    """What one step has gathered so far."""

    step: int
    nominal_hz: float
    ratio: int
    first_sample: int
    last_sample: int
    hold_s: float
    spans: list[Span] = field(default_factory=list)
    blocks: int = 0
    frequency_hz: float = np.nan
    frequency_uncertainty_hz: float = np.inf
    multiples: tuple[int, ...] = ()
    mains: tuple[MainsLine, ...] = ()
    folded: LockIn | None = None
    mask_level: int = N_MASK_LEVELS
    looks: list[step_fit.ChunkFit] = field(default_factory=list)

    @property
    def rows(self) -> list[int]:
        """Which of the fitted tones are the forcing's."""
        return [self.multiples.index(m) for m in sorted({1, self.ratio}) if m in self.multiples]

    def clear_sorts(self, places: tuple[int, ...] = (CONTACT, NEITHER, FLIGHT)) -> Ints:
        """Sorts of the given places that are clear of the chosen mask."""
        return np.array(
            [p * N_MASK_LEVELS + b for p in places for b in range(self.mask_level, N_MASK_LEVELS)], dtype=np.int64
        )


def multiples_of(ratio: int) -> tuple[int, ...]:
    """Multiples of the forcing that are fitted: harmonics of the first tone to `HARMONICS`, and of the second to 3."""
    return tuple(sorted(set(range(1, HARMONICS + 1)) | {ratio * k for k in (1, 2, 3)}))


def block_width(rate_hz: float, steps: npt.NDArray[np.void]) -> int:
    """Samples averaged: at most `BLOCK_S`, and three blocks a period of the highest tone anywhere."""
    highest = max((float(s["frequency_hz"]) * max(multiples_of(int(s["ratio"]))) for s in steps), default=1.0)
    return max(1, min(int(rate_hz * BLOCK_S), int(rate_hz / (3.0 * highest))))


class StepAccumulator:
    """Folds pieces of a recording into one `StepPlate` a step.

    Parameters
    ----------
    recording : Recording
    steps : STEP_DTYPE array
        Frequencies filled in.
    mask_s : float
        How long after an impact the accelerometer is left out.
    """

    def __init__(self, recording: Recording, steps: npt.NDArray[np.void], mask_s: float) -> None:
        self.recording, self.steps = recording, steps
        self.rate_hz = recording.rate_hz
        self.width = block_width(self.rate_hz, steps)
        rate = self.rate_hz / self.width
        self.masks = np.array([max(int(np.ceil(part * mask_s * rate)), 1) for part in PARTS])
        self.starts = steps["first_sample"] + steps["settle_samples"]
        self.stops = steps["first_sample"] + steps["n_samples"]
        self.done: list[StepPlate | None] = []
        self.fold: StepState | None = None
        self.mains = [line_of(hz) for hz in MAINS_HZ]
        self.hits: list[Ints] = []

    def add(self, piece: Piece, hits: Ints) -> None:
        """Fold one piece; ``hits`` are the samples of the landings found in it, in any order."""
        self.hits = [*self.hits[-1:], hits]
        begins = np.sort(np.concatenate(self.hits))
        means = {name: block_means(piece.own(name), self.width, -piece.first % self.width) for name in piece.channels}
        for k in range(len(self.done), len(self.steps)):
            start, stop = int(self.starts[k]), int(self.stops[k])
            if start >= piece.last:
                return
            if self.fold is None:
                hold_s = max((stop - start) / self.rate_hz, 1.0 / self.rate_hz)
                nominal, ratio = float(self.steps["frequency_hz"][k]), int(self.steps["ratio"][k])
                middle_s = 0.5 * (start + stop) / self.rate_hz
                lines = tuple(line.later(middle_s) for line in self.mains)
                self.fold = StepState(k, nominal, ratio, start, start, hold_s, mains=lines)
            self._take(self.fold, piece, means, max(start, piece.first), min(stop, piece.last), begins)
            if stop <= piece.last:
                self._close_step()
            elif self.fold.blocks > CHAPTER:
                self.flush_chunk(self.fold)

    def finish(self) -> tuple[StepPlate | None, ...]:
        """Close what is open (a recording cut within a step) and return all steps."""
        if self.fold is not None:
            self._close_step()
        self.done += [None] * (len(self.steps) - len(self.done))
        return tuple(self.done)

    def _take(
        self,
        fold: StepState,
        piece: Piece,
        means: dict[str, npt.NDArray[np.float32]],
        start: int,
        stop: int,
        hits: Ints,
    ) -> None:
        """Keep the means of ``[start, stop)`` as spans, broken at gaps."""
        gaps = self.recording.gaps
        cuts = [start, *(int(g) for g in gaps[:, 0] if start < g < stop), stop]
        for a, b in pairwise(cuts):
            lost = int(gaps[gaps[:, 0] <= a, 1].sum())
            if lost % self.width:  # the grid of blocks is another one after lost samples
                means = {n: block_means(piece.own(n), self.width, -(piece.first + lost) % self.width) for n in means}
            block, end = -(-(a + lost) // self.width), (b + lost) // self.width
            if end <= block:
                continue
            origin = -(-(piece.first + lost) // self.width)
            own = slice(block - origin, end - origin)
            values = np.zeros((end - block, 2))
            values[:, 0] = means["accelerometer"][own]
            if "drive" in means:
                values[:, 1] = means["drive"][own]
            fraction = means["continuity"][own] if "continuity" in means else np.full(end - block, 0.5, np.float32)
            fold.spans.append(Span(block, values, self._sort(block, end, hits + lost, fraction)))
            fold.blocks += end - block
            fold.last_sample = b

    def _sort(self, block: int, end: int, hits: Ints, fraction: npt.NDArray[np.float32]) -> npt.NDArray[np.int8]:
        """Place and band of blocks; the block in which an impact begins, a little early, is touched."""
        blocks = np.arange(block, end)
        place = np.where(fraction > 0.9, FLIGHT, np.where(fraction < 0.1, CONTACT, NEITHER))
        if not hits.size:
            return (place * N_MASK_LEVELS + N_MASK_LEVELS - 1).astype(np.int8)
        begins = (hits - int(LEAD_S * self.rate_hz)) // self.width
        last = np.searchsorted(begins, blocks, side="right") - 1
        since = np.where(last >= 0, blocks - (hits // self.width)[np.maximum(last, 0)], np.iinfo(np.int32).max)
        return (place * N_MASK_LEVELS + np.searchsorted(self.masks, since, side="left")).astype(np.int8)

    def flush_chunk(self, fold: StepState) -> None:
        """Turn the gathered spans into normal equations and a second look, and forget them."""
        if not fold.spans:
            return
        rate = self.rate_hz / self.width
        if fold.folded is None:
            fold.frequency_hz = fold.nominal_hz
            self._accumulate(fold, rate)
            look = step_fit.second_look(fold, rate)
            refined = None if look is None else step_fit.refined_hz(fold, look, "drive" in self.recording.channels)
            if refined is not None:
                fold.frequency_hz, fold.frequency_uncertainty_hz, changed = refined
                if changed:
                    self._accumulate(fold, rate)
                    look = step_fit.second_look(fold, rate)
            if look is not None and self._follow_mains(fold, look, rate):
                self._accumulate(fold, rate)
                look = step_fit.second_look(fold, rate)
        else:
            self._accumulate(fold, rate)
            look = step_fit.second_look(fold, rate)
        if look is not None:
            fold.looks.append(look)
        fold.spans.clear()
        fold.blocks = 0

    def _accumulate(self, fold: StepState, rate_hz: float) -> None:
        """Fold the spans in; the first chapter sets the tones, and the mask by how much it leaves of them."""
        fold.multiples, frequencies = self._frequencies(fold)
        if fold.folded is None or not np.array_equal(fold.folded.frequencies_hz, frequencies):
            fold.folded = LockIn(rate_hz, frequencies, 2, self.width, sorts=3 * N_MASK_LEVELS)
            fold.mask_level = N_MASK_LEVELS
        for span in fold.spans:
            fold.folded.add(span.values, span.first, span.sort)
        if fold.mask_level == N_MASK_LEVELS:
            fold.mask_level = _least_band(fold, fold.folded)

    def _frequencies(self, fold: StepState) -> tuple[tuple[int, ...], Floats]:
        """Tones of the step: what fits under the blocks' rate, and mains lines that the step can tell apart."""
        limit = 0.45 * self.rate_hz / self.width
        multiples = tuple(m for m in multiples_of(fold.ratio) if m == 1 or m * fold.frequency_hz < limit)
        tones = fold.frequency_hz * np.array(multiples)
        lines = lines_apart([m.hz for m in fold.mains if m.hz < limit], tones, fold.hold_s)
        return multiples, np.concatenate([tones, lines])

    def _follow_mains(self, fold: StepState, look: step_fit.ChunkFit, rate_hz: float) -> bool:
        """Move the step's mains lines to where they are heard; whether any was."""
        length_s, fit = fold.blocks / rate_hz, look.fits[0]
        tones = len(fold.multiples)
        every_hz = fit.frequencies_hz.copy()
        for i, line in enumerate(fold.mains):
            place = next((k for k in range(tones, len(every_hz)) if every_hz[k] == line.hz), None)
            if place is None:
                continue

            def fit_at(hz: float, place: int = place) -> ToneFit:
                trial = LockIn(rate_hz, np.concatenate([every_hz[:place], [hz], every_hz[place + 1 :]]), 1, self.width)
                for span in fold.spans:
                    trial.add(span.values[:, :1], span.first, span.sort % N_MASK_LEVELS >= fold.mask_level)
                return trial.solve()

            begin_hz = line.hz
            if length_s * line.reach_hz > LOBE:
                begin_hz = heard_hz(*_left_by(fold, fit, place, rate_hz), line, length_s)
            found = moved(line, place, fit_at, begin_hz, np.delete(every_hz, place), length_s)
            every_hz[place] = found.hz
            fold.mains = (*fold.mains[:i], found, *fold.mains[i + 1 :])
        self.mains = list(fold.mains)
        return not np.array_equal(every_hz, fit.frequencies_hz)

    def _close_step(self) -> None:
        """Solve the step and keep its result."""
        fold, self.fold = self.fold, None
        if fold is None:
            return
        self.flush_chunk(fold)
        self.done.append(None if fold.folded is None else step_fit.step_plate(self.recording, fold))


def _left_by(fold: StepState, fit: ToneFit, kept: int, rate_hz: float) -> tuple[Floats, Floats]:
    """What the fit leaves of the accelerometer's clear blocks, its tone ``kept`` left in; and when, in seconds."""
    own = LockIn(rate_hz, fit.frequencies_hz, 1, 1 if fold.folded is None else fold.folded.boxcar)
    z = np.delete(fit.amplitudes * own.response(), kept)
    turns = 2j * np.pi * np.delete(fit.frequencies_hz, kept)
    left, when = [], []
    for span in fold.spans:
        clear = span.sort % N_MASK_LEVELS >= fold.mask_level
        time_s = (span.first + np.flatnonzero(clear)) / rate_hz
        model = sum(((a * np.exp(w * time_s)).real for a, w in zip(z, turns, strict=True)), np.zeros(len(time_s)))
        left.append(span.values[clear, 0] - fit.offset - model)
        when.append(time_s)
    return np.concatenate(left), np.concatenate(when)


def _least_band(fold: StepState, folded: LockIn) -> int:
    """The longest mask that leaves enough of the step to hold the forcing's tones.

    Impacts at the same phases of every cycle may leave holes that tones and harmonics fill at will; then the mask is
    shortened (the learnt waveform has been subtracted anyway) until no tone's uncertainty is more than `MOST_INFLATED`
    times that of an unmasked step.
    """
    counts = folded.counts.reshape(3, N_MASK_LEVELS).sum(axis=0)
    whole = int(counts.sum())
    for band in range(N_MASK_LEVELS - 1, 1, -1):
        kept = int(counts[band:].sum())
        if kept > SURELY_CLEAR * whole:
            return band
        if kept < 8 * folded.frequencies_hz.size:
            continue
        fold.mask_level = band
        try:
            spread = np.diag(folded.part(fold.clear_sorts()).inverse())
        except ValueError:
            continue
        worst = max(float(spread[2 * r + 1] + spread[2 * r + 2]) for r in fold.rows)
        if worst < 4.0 / whole * MOST_INFLATED**2:
            return band
    return 1
