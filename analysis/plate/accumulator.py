"""Streaming normal equations of the plate's tones in each step.

Samples are averaged over blocks much shorter than a period; the gain and delay of the average are taken out exactly.
Blocks just after an impact are masked, and each block counts as contact, as flight or as neither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from analysis.plate.line_trials import LineTrials
from analysis.plate.mains_lines import (
    LOBE,
    MAINS_HZ,
    MAX_OFFSET_HZ,
    is_absent,
    refined_line,
    separable_lines,
    strongest_hz,
    unmeasured_line,
)
from analysis.plate.motion import StepPlate
from analysis.plate.step_fit import STEP_SAMPLES, step_plate
from analysis.plate.step_state import (
    CONTACT,
    FLIGHT,
    MASK_PARTS,
    N_BLOCK_CLASSES,
    N_MASK_LEVELS,
    NEITHER,
    ChunkFit,
    DriveReading,
    Span,
    StepState,
    multiples_of,
)
from analysis.plate.tone_noise import converter_step
from analysis.plate.windows import fit_windows, refined_hz
from analysis.signals import block_means
from daq.instrument.channel_limits import NO_ENDS, Ends, blocks_at_an_end, drive_is_cut_off
from daq.lock_in import LockIn
from daq.recording import Recording
from daq.setup.setup import Forcing
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

Volts = npt.NDArray[np.float32]
Means = tuple[Volts, Volts | None, Volts | None, Bools | None]

BLOCK_S = 1e-3  # longest block of samples averaged before the fit
LEAD_S = 2e-4  # time before an impact that is masked with it
HARMLESS_COVER = 0.85  # unmasked part of a step above which no mask can do harm
MAX_INFLATION, MOST_INFLATION = 1.6, 5.0  # largest factors by which a mask may raise a tone's uncertainty
TOO_FEW = 20.0  # factor from which fewer harmonics are fitted: one of a percent that is left out does less harm


@dataclass(frozen=True)
class PlatePiece:
    """Samples from ``first`` on as the plate's fit takes them, arrays (n,)."""

    first: int
    acceleration_v: Volts  # accelerometer volts less the waveforms of the impacts found
    drive_v: Volts | None  # drive volts; None where the drive was not recorded
    # contact voltage as a fraction of the swing, 0 closed, 1 open; None without a contact circuit
    open_fraction: Volts | None
    codes: npt.NDArray[Any] | None = None  # accelerometer as it is stored, where that is at hand

    @property
    def last(self) -> int:
        """One past the last sample."""
        return self.first + self.acceleration_v.size

    def means(self, width: int, lost: int, ends: Ends) -> Means:
        """Means over blocks of ``width`` samples on the grid that counts ``lost`` samples before the piece.

        Of accelerometer, drive and open fraction; last, which blocks hold a code at or beyond one of the ``ends``.
        """
        skip = -(self.first + lost) % width
        drive = None if self.drive_v is None else block_means(self.drive_v, width, skip)
        fraction = None if self.open_fraction is None else block_means(self.open_fraction, width, skip)
        cut_off = None
        if self.codes is not None and np.any(np.isfinite(ends)):
            cut_off = blocks_at_an_end(self.codes, width, skip, ends)
        return block_means(self.acceleration_v, width, skip), drive, fraction, cut_off


def block_width(rate_hz: float, steps: npt.NDArray[np.void], forcing: Forcing) -> int:
    """Samples averaged: at most `BLOCK_S`, and three blocks a period of the highest tone anywhere."""
    highest = max(
        (float(s["frequency_hz"]) * max(multiples_of(forcing.multiples_at(int(s["ratio"])))) for s in steps),
        default=1.0,
    )
    return max(1, min(int(rate_hz * BLOCK_S), int(rate_hz / (3.0 * highest))))


class StepAccumulator:
    """Normal equations of every step from successive pieces of a recording; one `StepPlate` a step.

    Parameters
    ----------
    recording : Recording
    steps : STEP_DTYPE array
        Frequencies filled in.
    mask_s : float
        How long after an impact the accelerometer is left out.
    ends_v : pair of float
        Volts at which the accelerometer is at its end: blocks that reach them are left out, too.
    """

    def __init__(
        self, recording: Recording, steps: npt.NDArray[np.void], mask_s: float, ends_v: Ends = NO_ENDS
    ) -> None:
        self.recording, self.steps = recording, steps
        self.rate_hz = recording.rate_hz
        factor, offset = recording.scale("accelerometer")
        low, high = sorted((end - offset) / factor for end in ends_v)
        self.ends = low, high  # as codes
        self.width = block_width(self.rate_hz, steps, recording.setup.forcing)
        self.block_rate_hz = self.rate_hz / self.width
        self.masks = np.array([max(int(np.ceil(part * mask_s * self.block_rate_hz)), 1) for part in MASK_PARTS])
        self.starts = steps["first_sample"] + steps["settle_samples"]
        self.stops = steps["first_sample"] + steps["n_samples"]
        self.done: list[StepPlate | None] = []
        self.waiting: list[StepState] = []
        self.open: StepState | None = None
        self.mains = [unmeasured_line(hz) for hz in MAINS_HZ]
        self.impacts: list[Integers] = []

    def add(self, piece: PlatePiece, impacts: Integers) -> None:
        """Add one piece; ``impacts`` are the samples of the landings found in it, in any order."""
        self.impacts = [*self.impacts[-1:], impacts]
        begins = np.sort(np.concatenate(self.impacts))

        @cache
        def means(lost: int) -> Means:
            return piece.means(self.width, lost, self.ends)

        for k in range(len(self.done) + len(self.waiting), len(self.steps)):
            start, stop = int(self.starts[k]), int(self.stops[k])
            if start >= piece.last:
                return
            if self.open is None:
                self.open = self._begin_step(k)
                if piece.codes is not None and piece.first <= start <= piece.last - STEP_SAMPLES:
                    self.open.first_codes = piece.codes[start - piece.first :][:STEP_SAMPLES].copy()
            if piece.drive_v is not None and not self.open.drive_reads.cut_off:
                own = piece.drive_v[max(start - piece.first, 0) : stop - piece.first][:STEP_SAMPLES]
                # fewer samples of a step that goes on would be a part of a cycle
                whole = own.size == min(STEP_SAMPLES, stop - start) > 0
                if whole:
                    self.open.drive_reads = DriveReading(drive_is_cut_off(own, self.rate_hz), converter_step(own))
            for a, b in self._unbroken(max(start, piece.first), min(stop, piece.last)):
                self._add_span(self.open, piece.first, (a, b), means, begins)
            if stop <= piece.last:
                self._close_step()
            # block means in memory, before they are added to the normal equations
            elif self.open.blocks > (1 << 17):
                self._solve_waiting()  # their mains lines come before this step's
                self.flush_chunk(self.open)

    def finish(self) -> tuple[StepPlate | None, ...]:
        """Close what is open (a recording cut within a step) and return all steps."""
        if self.open is not None:
            self._close_step()
        self._solve_waiting()
        self.done += [None] * (len(self.steps) - len(self.done))
        return tuple(self.done)

    def _begin_step(self, k: int) -> StepState:
        """State of step ``k`` before its first sample."""
        start, stop = int(self.starts[k]), int(self.stops[k])
        hold_s = max((stop - start) / self.rate_hz, 1.0 / self.rate_hz)
        nominal_hz, ratio = float(self.steps["frequency_hz"][k]), int(self.steps["ratio"][k])
        ends = self.ends if np.any(np.isfinite(self.ends)) else None
        driven = self.recording.setup.forcing.multiples_at(ratio)
        return StepState(k, nominal_hz, driven, start, start, hold_s, ends=ends)

    def _unbroken(self, start: int, stop: int) -> list[tuple[int, int]]:
        """``[start, stop)`` broken at lost samples."""
        gaps = self.recording.gaps
        return list(pairwise([start, *(int(g) for g in gaps[:, 0] if start < g < stop), stop]))

    def _add_span(
        self,
        state: StepState,
        first: int,
        samples: tuple[int, int],
        means: Callable[[int], Means],
        impacts: Integers,
    ) -> None:
        """Keep the block means of unbroken ``samples`` of the piece that begins at ``first``."""
        gaps = self.recording.gaps
        lost = int(gaps[gaps[:, 0] <= samples[0], 1].sum())
        block, end = -(-(samples[0] + lost) // self.width), (samples[1] + lost) // self.width
        if end <= block:
            return
        acceleration, drive, fraction, cut_off = means(lost)
        origin = -(-(first + lost) // self.width)
        own = slice(block - origin, end - origin)
        values = np.zeros((end - block, 2))
        values[:, 0] = acceleration[own]
        if drive is not None:
            values[:, 1] = drive[own]
        open_fraction = np.full(end - block, 0.5, np.float32) if fraction is None else fraction[own]
        impacts, classes = impacts + lost, np.empty(end - block, dtype=np.int8)
        begins = (impacts - int(LEAD_S * self.rate_hz)) // self.width
        _classify(block, open_fraction, begins, impacts // self.width, self.masks, classes)
        if cut_off is not None:  # masked as if an impact had been there
            classes -= np.where(cut_off[own], classes % N_MASK_LEVELS, 0).astype(np.int8)
        state.spans.append(Span(block, values, classes))
        state.blocks += end - block
        state.last_sample = samples[1]

    def flush_chunk(self, state: StepState) -> None:
        """Add the open spans to the normal equations, fit their windows, and forget them."""
        if not state.spans:
            return
        if state.lock_in is None:
            chunk = self._first_chunk(state)
        else:
            self._accumulate(state)
            chunk = fit_windows(state, self.block_rate_hz)
        if chunk is not None:
            state.chunks.append(chunk)
        state.spans.clear()
        state.blocks = 0

    def _first_chunk(self, state: StepState) -> ChunkFit | None:
        """The first chunk of a step, which also settles the frequencies of its tones and of the mains lines."""
        state.frequency_hz = state.nominal_hz
        middle_s = 0.5 * (int(self.starts[state.step]) + int(self.stops[state.step])) / self.rate_hz
        state.mains = tuple(line.later(middle_s) for line in self.mains)  # where the steps before left them
        self._accumulate(state)
        chunk = fit_windows(state, self.block_rate_hz)
        refined = None if chunk is None else refined_hz(state, chunk, "drive" in self.recording.channels)
        if refined is not None:
            state.frequency_hz, state.frequency_uncertainty_hz, changed = refined
            if changed and self._corrected(state.step):
                state.frequency_hz, changed = state.nominal_hz, False
            if changed:
                self._accumulate(state)
                chunk = fit_windows(state, self.block_rate_hz)
        if chunk is not None and self._follow_mains(state, chunk):
            self._accumulate(state)
            chunk = fit_windows(state, self.block_rate_hz)
        return chunk

    def _corrected(self, step: int) -> bool:
        """Whether the drive was corrected within a hold: its phase then wanders without a frequency of its own."""
        changed_at = self.recording.drive_changes["first_sample"]
        return bool(np.any((changed_at >= self.starts[step]) & (changed_at < self.stops[step])))

    def _accumulate(self, state: StepState) -> None:
        """Add the open spans; a change of frequencies starts afresh, and the first spans choose the mask."""
        state.multiples, frequencies = self._frequencies(state)
        if state.lock_in is None or not np.array_equal(state.lock_in.frequencies_hz, frequencies):
            state.lock_in = LockIn(self.block_rate_hz, frequencies, 2, self.width, sorts=N_BLOCK_CLASSES)
            state.mask_level = N_MASK_LEVELS
        for span in state.spans:
            state.lock_in.add(span.values, span.first, span.block_class)
        if state.mask_level == N_MASK_LEVELS:
            state.mask_level, inflation = _choose_mask_level(state, state.lock_in)
            if inflation > TOO_FEW and state.multiples[-1] > max(*state.forcing, 2):
                state.most_multiple, state.lock_in = state.multiples[-2], None
                self._accumulate(state)

    def _frequencies(self, state: StepState) -> tuple[tuple[int, ...], Floats]:
        """Tones of the step: what fits under the blocks' rate; mains lines that can be separated; their multiples."""
        # short of half the blocks' rate, beyond which a tone would be folded back
        limit = 0.45 * self.block_rate_hz
        most = min(state.most_multiple, limit / state.frequency_hz)
        multiples = tuple(m for m in multiples_of(state.forcing) if m == 1 or m <= most)
        tones = state.frequency_hz * np.array(multiples)
        mains = [m.hz for m in state.mains] + [hz for m in state.mains for hz in m.multiples_hz]
        # a line on a multiple of the forcing is never measured
        mains += [k * m.hz for m in state.mains if (np.abs(tones - m.hz) < MAX_OFFSET_HZ).any() for k in (3, 5, 7)]
        lines = separable_lines([hz for hz in mains if hz < limit], tones, state.hold_s)
        return multiples, np.concatenate([tones, lines])

    def _follow_mains(self, state: StepState, chunk: ChunkFit) -> bool:
        """Refine the frequencies of the step's mains lines; whether any changed."""
        fit, length_s = chunk.fits[0], state.blocks / self.block_rate_hz
        tones = len(state.multiples)
        every_hz, before = fit.frequencies_hz.copy(), state.mains
        trials: LineTrials | None = None
        for i, line in enumerate(state.mains):
            place = next((k for k in range(tones, len(every_hz)) if every_hz[k] == line.hz), None)
            if place is None:
                continue
            line = line.with_noise(chunk.near[place - tones])
            state.mains = (*state.mains[:i], line, *state.mains[i + 1 :])
            if trials is None and is_absent(fit, place, line, chunk.beats[:, place - tones], length_s):
                continue
            trials = trials or LineTrials(state, self.block_rate_hz)
            begin_hz = line.hz
            if length_s * line.reach_hz > LOBE:
                begin_hz, _ = strongest_hz(trials.demodulated(fit, place), line, length_s)
            fit_at = partial(trials.fit_at, place)
            found = refined_line(line, place, fit_at, begin_hz, np.delete(every_hz, place), length_s)
            if found.hz != every_hz[place]:
                trials.move(place, found.hz)
            every_hz[place] = found.hz
            state.mains = (*state.mains[:i], found, *state.mains[i + 1 :])
        self.mains = list(state.mains)
        moved = any((a.hz, a.sigma_hz) != (b.hz, b.sigma_hz) for a, b in zip(before, state.mains, strict=True))
        return moved and not np.array_equal(self._frequencies(state)[1], fit.frequencies_hz)

    def _close_step(self) -> None:
        """Let the open step wait for others."""
        if self.open is not None:
            self.waiting.append(self.open)
        self.open = None
        # sixteen steps solved in a row: what their small fits need then stays in the processor's caches
        if len(self.waiting) >= 16:
            self._solve_waiting()

    def _solve_waiting(self) -> None:
        """Solve the steps that wait, in order, and keep their results."""
        for state in self.waiting:
            self.flush_chunk(state)
            self.done.append(None if state.lock_in is None else step_plate(self.recording, state))
        self.waiting.clear()


def _choose_mask_level(state: StepState, lock_in: LockIn) -> tuple[int, float]:
    """Level of the longest mask that leaves enough of the step to fit the forcing's tones, and what it costs them.

    Impacts at the same phases of every cycle may leave holes that tones and harmonics can fill freely. The mask is then
    shortened until no tone's uncertainty is more than `MAX_INFLATION` times that of an unmasked step: the impacts'
    waveform has been subtracted. Where more of it is left than noise, up to `MOST_INFLATION` is accepted. The cost is
    that factor, infinite where the tones cannot be separated.
    """
    counts = lock_in.counts.reshape(3, N_MASK_LEVELS).sum(axis=0)
    whole = int(counts.sum())
    longest_rms: float | None = None
    longest, cost = 1, np.inf
    costly = []  # where each costs more, as those of a motion that is cut off do: sigma of a tone, and level
    for level in range(N_MASK_LEVELS - 1, 0, -1):
        left = int(counts[level:].sum())
        if left > HARMLESS_COVER * whole and longest_rms is None:
            return level, 1.0
        # each tone needs eight unmasked blocks
        if left < 8 * lock_in.frequencies_hz.size:
            continue
        state.mask_level = level
        total = lock_in.part(state.clear_classes())
        try:
            # without a mask both quadratures of a tone have the variance 4 / n together
            spread = np.diag(total.inverse())
            inflation = max(float(spread[2 * r + 1] + spread[2 * r + 2]) for r in state.rows) * whole / 4.0
            rms = total.solve(0).rms
        except ValueError:
            continue
        inflation = float(np.sqrt(inflation))
        costly.append((inflation * rms, level))
        if level == 1:
            return (min(costly)[1], inflation) if longest_rms is None else (longest, cost)
        if inflation > MOST_INFLATION:
            continue
        if longest_rms is None:
            longest, longest_rms, cost = level, rms, inflation
        if inflation < MAX_INFLATION or left > HARMLESS_COVER * whole:
            # a residual 10 % above that with the longest mask is ringing, which the shorter mask leaves in
            return (level, inflation) if rms < 1.1 * longest_rms else (longest, cost)
    return longest, cost


@njit(error_model="numpy")
def _classify(first, fraction, begins, impacts, masks, out):  # type: ignore[no-untyped-def]
    """Place and mask level of blocks from ``first`` on, after impacts in the blocks ``impacts``, in order of time."""
    last, levels = -1, masks.shape[0]
    for i in range(out.shape[0]):
        block = first + i
        while last + 1 < begins.shape[0] and begins[last + 1] <= block:
            last += 1
        level = levels if last < 0 else 0
        while level < levels and masks[level] < block - impacts[last]:
            level += 1
        open_part = fraction[i]
        # a block that is less than nine tenths in flight or in contact is neither
        place = FLIGHT if open_part > 0.9 else CONTACT if open_part < 0.1 else NEITHER
        out[i] = place * N_MASK_LEVELS + level
