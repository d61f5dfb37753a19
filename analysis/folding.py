"""Accelerometer and drive of each step folded into tone fits, while the recording streams by.

The rule kept here: samples are averaged over blocks much shorter than a period (the blocks' gain and delay are taken
out exactly), blocks that an impact touches are left out, and each block counts as contact, as flight or as neither.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from analysis import tone_results
from analysis.plate_motion import StepPlate
from analysis.stream import Piece, block_means
from daq.recording import Recording
from daq.tones import LockIn, ToneFit

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

HARMONICS = 5
MAINS_HZ = (50.0, 60.0)
BLOCK_S = 1e-3  # longest block of samples averaged before the fit
LEAD_S = 2e-4  # masked before an impact
SURELY_CLEAR = 0.85  # of a step, above which no mask can do harm
MOST_INFLATED = 1.6  # of a tone's uncertainty, by the mask
LOOKED_CYCLES = 12.0  # of a step, on which the mask is judged
CHAPTER = 1 << 18  # means kept in memory before they are folded in


@dataclass(frozen=True)
class Span:
    """Consecutive block means: block ``first`` (counted from sample 0, lost samples included) and on."""

    first: int
    accelerometer: npt.NDArray[np.float32]
    drive: npt.NDArray[np.float32]
    in_air: npt.NDArray[np.int8]  # 1 flight, 0 contact, -1 neither
    since: npt.NDArray[np.int32]  # blocks since the last impact; 0 where one falls into it
    clear: npt.NDArray[np.bool_]  # no impact rings in it


@dataclass
class StepFold:
    """What one step has gathered so far."""

    step: int
    nominal_hz: float
    ratio: int
    first_sample: int
    last_sample: int
    width: int
    spans: list[Span] = field(default_factory=list)
    frequency_hz: float = np.nan
    frequency_uncertainty_hz: float = np.nan
    contact: LockIn | None = None
    rest: LockIn | None = None
    flight: LockIn | None = None
    multiples: tuple[int, ...] = ()
    windows: list[tuple[Floats, npt.NDArray[np.complex128], Floats]] = field(default_factory=list)
    slow: list[tuple[Floats, Floats]] = field(default_factory=list)
    blocks: int = 0
    clear: int = 0


def multiples_of(ratio: int) -> tuple[int, ...]:
    """Multiples of the forcing that are fitted: harmonics of the first tone to `HARMONICS`, and of the second to 3."""
    return tuple(sorted(set(range(1, HARMONICS + 1)) | {ratio * k for k in (1, 2, 3)}))


def block_width(rate_hz: float, steps: npt.NDArray[np.void]) -> int:
    """Samples averaged: at most `BLOCK_S`, and five blocks a period of the highest tone anywhere."""
    highest = max((float(s["frequency_hz"]) * max(multiples_of(int(s["ratio"]))) for s in steps), default=1.0)
    return max(1, min(int(rate_hz * BLOCK_S), int(rate_hz / (3.0 * highest))))


class Folder:
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
        self.recording, self.steps, self.mask_s = recording, steps, mask_s
        self.rate_hz = recording.rate_hz
        self.width = block_width(self.rate_hz, steps)
        self.done: list[StepPlate | None] = []
        self.fold: StepFold | None = None
        self.hits: list[Ints] = []

    def add(self, piece: Piece, hits: Ints) -> None:
        """Fold one piece; ``hits`` are the samples of the landings found in it, in any order."""
        self.hits.append(hits)
        for k in range(len(self.done), len(self.steps)):
            start = int(self.steps["first_sample"][k] + self.steps["settle_samples"][k])
            stop = int(self.steps["first_sample"][k] + self.steps["n_samples"][k])
            if start >= piece.last:
                return
            if self.fold is None:
                self.fold = StepFold(
                    k, float(self.steps["frequency_hz"][k]), int(self.steps["ratio"][k]), start, start, self.width
                )
            self._take(piece, max(start, piece.first), min(stop, piece.last))
            if stop <= piece.last:
                self._close_step()
            elif self.fold.blocks > CHAPTER:
                self._close_chapter()

    def finish(self) -> tuple[StepPlate | None, ...]:
        """Close what is open (a recording cut within a step) and return all steps."""
        if self.fold is not None:
            self._close_step()
        self.done += [None] * (len(self.steps) - len(self.done))
        return tuple(self.done)

    def _take(self, piece: Piece, start: int, stop: int) -> None:
        """Average the samples ``[start, stop)`` into spans, broken at gaps."""
        if self.fold is None or stop <= start:
            return
        gaps = self.recording.gaps
        cuts = [start, *(int(g) for g in gaps[:, 0] if start < g < stop), stop]
        for a, b in pairwise(cuts):
            lost = int(gaps[gaps[:, 0] <= a, 1].sum())
            block = -(-(a + lost) // self.width)
            begin = block * self.width - lost
            count = (b - begin) // self.width
            if count <= 0:
                continue
            own = slice(begin - piece.first, begin - piece.first + count * self.width)
            means = {name: block_means(piece.own(name)[own], self.width) for name in piece.channels}
            self.fold.spans.append(self._span(block, count, lost, means))
            self.fold.blocks += count
            self.fold.last_sample = b

    def _span(self, block: int, count: int, lost: int, means: dict[str, npt.NDArray[np.float32]]) -> Span:
        """One span; impacts of the piece before count too."""
        hits = np.sort(np.concatenate(self.hits[-2:])) + lost
        blocks = block + np.arange(count)
        # the block in which an impact begins, a little early, counts as touched
        begins = (hits - int(LEAD_S * self.rate_hz)) // self.width
        last = np.searchsorted(begins, blocks, side="right") - 1
        began = np.append(hits // self.width, 0)  # there may be none: index -1 must still exist
        since = np.where(last >= 0, blocks - began[last], np.iinfo(np.int32).max // 2)
        fraction = means.get("continuity", np.full(count, 0.5, np.float32))
        in_air = np.where(fraction > 0.9, 1, np.where(fraction < 0.1, 0, -1)).astype(np.int8)
        drive = means.get("drive", np.zeros(count, np.float32))
        return Span(block, means["accelerometer"], drive, in_air, since.astype(np.int32), since > 0)

    def _close_chapter(self) -> None:
        """Turn the gathered spans into normal equations, windows and slow motion, and forget them."""
        fold = self.fold
        if fold is None or not fold.spans:
            return
        rate = self.rate_hz / self.width
        has_drive = "drive" in self.recording.channels
        if not np.isfinite(fold.frequency_hz):
            fold.frequency_hz, fold.frequency_uncertainty_hz = _refine(fold, rate, has_drive)
            fold.multiples, frequencies = self._frequencies(fold)
            fold.contact, fold.rest, fold.flight = (LockIn(rate, frequencies, 2, self.width) for _ in range(3))
        rows = [fold.multiples.index(m) for m in sorted({1, fold.ratio}) if m in fold.multiples]
        tones = fold.frequency_hz * np.array(fold.multiples)
        fold.spans[:] = _masked(fold.spans, self.mask_s * rate, tones, rows, rate)
        parts = ((fold.contact, 0), (fold.rest, -1), (fold.flight, 1))
        for span in fold.spans:
            values = np.column_stack([span.accelerometer, span.drive])
            for lock_in, where in parts:
                if lock_in is not None:
                    lock_in.add(values, span.first, span.clear & (span.in_air == where))
            fold.clear += int(span.clear.sum())
        fit = _solve(_total(fold), 0)
        if fit is not None:
            fold.windows.append(tone_results.windows(fold.spans, fit, rows, rate, self.width))
            fold.slow.append(tone_results.slow_motion(fold.spans, fit, rate, self.width, fold.frequency_hz))
        fold.spans.clear()
        self.hits = self.hits[-2:]

    def _frequencies(self, fold: StepFold) -> tuple[tuple[int, ...], Floats]:
        """Tones of the step: what fits under the blocks' rate, and mains lines that the step can tell apart."""
        row = self.steps[fold.step]
        hold_s = max((int(row["n_samples"]) - int(row["settle_samples"])) / self.rate_hz, 1.0 / self.rate_hz)
        limit = 0.45 * self.rate_hz / self.width
        multiples = tuple(m for m in multiples_of(fold.ratio) if m == 1 or m * fold.frequency_hz < limit)
        tones = fold.frequency_hz * np.array(multiples)
        lines = [m for m in MAINS_HZ if m < limit and np.abs(tones - m).min() > 0.5 / hold_s and hold_s > 5.0 / m]
        return multiples, np.concatenate([tones, lines])

    def _close_step(self) -> None:
        """Solve the step and keep its result."""
        self._close_chapter()
        fold, self.fold = self.fold, None
        if fold is None:
            return
        total = None if fold.contact is None else _total(fold)
        self.done.append(None if total is None else tone_results.step_plate(self.recording, fold, total))


def _masked(
    spans: list[Span], mask_blocks: float, frequencies_hz: Floats, rows: list[int], rate_hz: float
) -> list[Span]:
    """Spans with the blocks after impacts left out, as long as what is left still holds the forcing's tones ``rows``.

    Impacts at the same phases of every cycle may leave holes that tones and harmonics fill at will; then the mask is
    shortened (the learnt waveform has been subtracted anyway) until no tone's uncertainty is more than `MOST_INFLATED`
    times that of an unmasked step.
    """
    cycles = frequencies_hz / rate_hz
    looked = LOOKED_CYCLES / cycles[0]
    first = spans[0].first
    index = np.concatenate([s.first + np.arange(s.since.size) for s in spans if s.first - first < looked])
    since = np.concatenate([s.since for s in spans if s.first - first < looked])
    for part in (1.0, 0.7, 0.5, 0.35, 0.25):
        length = max(int(np.ceil(part * mask_blocks)), 1)
        kept = since > length
        if np.mean(kept) > SURELY_CLEAR:
            break
        if kept.sum() > 4 * (2 * cycles.size + 1):
            angle = 2.0 * np.pi * np.outer(index[kept], cycles)
            design = np.hstack([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)])
            spread = np.diag(np.linalg.pinv(design.T @ design, hermitian=True))
            worst = max(spread[1 + r] + spread[1 + cycles.size + r] for r in rows)
            if worst < 4.0 / since.size * MOST_INFLATED**2:
                break
    return [replace(s, clear=s.since > length) for s in spans]


def _total(fold: StepFold) -> LockIn:
    """Contact, flight and what is neither, together."""
    if fold.contact is None or fold.rest is None or fold.flight is None:
        raise ValueError("nothing folded yet")
    return fold.contact + fold.rest + fold.flight


def _solve(lock_in: LockIn, channel: int) -> ToneFit | None:
    """The fit, or None where the step is too short for it."""
    try:
        return lock_in.solve(channel)
    except ValueError:
        return None


def _refine(fold: StepFold, rate_hz: float, has_drive: bool) -> tuple[float, float]:
    """Frequency of the first tone on the recording's clock, measured where that beats the step table.

    The phase of the strongest forcing tone is followed through eight parts of the step, of the drive where it was
    recorded (it carries neither impacts nor the ball), else of the accelerometer.
    """
    frequency = fold.nominal_hz
    sigma = np.inf
    blocks = sum(s.clear.size for s in fold.spans)
    parts = int(np.clip(blocks / rate_hz * frequency / 2.0, 0, 8))
    if parts < 3:
        return frequency, np.inf
    for _ in range(3):
        phases = [_part_phase(fold, rate_hz, frequency, has_drive, k, parts) for k in range(parts)]
        known = [p for p in phases if p is not None]
        if len(known) < 3:
            return fold.nominal_hz, np.inf
        time_s, angle, weight, multiple = (np.array(column) for column in zip(*known, strict=True))
        angle = np.unwrap(angle)
        coefficients, covariance = np.polyfit(time_s - time_s.mean(), angle, 1, w=weight, cov="unscaled")
        step = coefficients[0] / (2.0 * np.pi * multiple[0])
        sigma = float(np.sqrt(covariance[0, 0])) / (2.0 * np.pi * multiple[0])
        if abs(step) < 4.0 * sigma and frequency == fold.nominal_hz:
            return frequency, sigma
        frequency += float(step)
        if abs(step) < 0.1 * sigma:
            break
    return frequency, sigma


def _part_phase(
    fold: StepFold, rate_hz: float, frequency_hz: float, has_drive: bool, part: int, parts: int
) -> tuple[float, float, float, int] | None:
    """Middle time, phase and 1/sigma of the strongest forcing tone in one part of the step, and its multiple."""
    tones = np.unique([1, fold.ratio])
    lock_in = LockIn(rate_hz, frequency_hz * tones, 1, fold.width)
    begin, end = fold.spans[0].first, fold.spans[-1].first + fold.spans[-1].clear.size
    low, high = begin + (end - begin) * part // parts, begin + (end - begin) * (part + 1) // parts
    for span in fold.spans:
        a, b = max(low - span.first, 0), min(high - span.first, span.clear.size)
        if b > a:
            values = span.drive if has_drive else span.accelerometer
            lock_in.add(values[a:b], span.first + a, None if has_drive else span.clear[a:b])
    fit = _solve(lock_in, 0)
    if fit is None:
        return None
    strongest = int(np.argmax(np.abs(fit.amplitudes) * tones))
    sigma = float(fit.amplitude_sigma()[strongest]) / max(float(np.abs(fit.amplitudes[strongest])), 1e-300)
    if sigma > 0.3:
        return None
    middle, angle = 0.5 * (low + high) / rate_hz, float(np.angle(fit.amplitudes[strongest]))
    return middle, angle, 1.0 / max(sigma, 1e-9), int(tones[strongest])
