"""State of one step's fit while the recording streams by, and the samples that the fit leaves out.

A tone is a pair of complex exponentials ``exp(i w t)`` and ``exp(-i w t)``; their sums over unmasked intervals, shifts
and amplitude modulations are closed forms. Predictions use the same intervals as the fits, so masked samples never
enter either.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from analysis.linear_algebra import solve
from analysis.plate.mains_lines import MainsLine
from daq.instrument.channel_limits import Ends
from daq.lock_in import LockIn, ToneFit
from kernels import njit
from kernels.arrays import Bools, Complexes, Floats, Integers

RIDGE = 1e-9  # added to normal equations whose diagonal is 1


@dataclass(frozen=True)
class FitIntervals:
    """Unmasked intervals, none of them across the bounds of a window or of a contact; arrays (r,)."""

    step: Integers  # row of the step, in order
    span_s: Floats  # begin and end on the time axis of the tones' phases, (r, 2)
    window: Integers  # row of the window that the interval is part of; -1 for none
    contact: Bools  # whether the ball lay on the plate all the while

    @classmethod
    def whole(cls, span_s: Floats) -> Self:
        """One unmasked interval a step, ``span_s`` (m, 2)."""
        m = len(span_s)
        return cls(np.arange(m), span_s, np.full(m, -1), np.zeros(m, dtype=np.bool_))

    @classmethod
    def join(cls, parts: Sequence[Self], steps: Integers, windows: Integers) -> Self:
        """All parts in one, their rows of steps and windows counted on from ``steps`` and ``windows``."""
        if not parts:
            return cls.whole(np.zeros((0, 2)))
        return cls(
            np.concatenate([p.step + s for p, s in zip(parts, steps, strict=True)]),
            np.concatenate([p.span_s for p in parts]),
            np.concatenate([np.where(p.window < 0, -1, p.window + w) for p, w in zip(parts, windows, strict=True)]),
            np.concatenate([p.contact for p in parts]),
        )

    @classmethod
    def of_blocks(cls, first: int, keep: Bools, window: Integers, contact: Bools, block_s: float) -> Self:
        """Intervals of consecutive blocks from number ``first`` on: ``keep``, ``window`` and ``contact`` are (n,)."""
        bounds = _alike(keep, window, contact)
        at = bounds[:, 0]
        return cls(np.zeros(len(at), dtype=np.int64), (first + bounds) * block_s, window[at], contact[at])

    @cached_property
    def seconds(self) -> Floats:
        """Length of each interval."""
        return np.asarray(self.span_s[:, 1] - self.span_s[:, 0])

    @cached_property
    def in_windows(self) -> Self:
        """Intervals within windows, ordered by window; the window takes the place of the step."""
        rows = np.flatnonzero(self.window >= 0)
        rows = rows[np.argsort(self.window[rows], kind="stable")]
        return type(self)(self.window[rows], self.span_s[rows], self.window[rows], self.contact[rows])

    @cached_property
    def in_contact(self) -> Self:
        """Intervals in contact."""
        rows = self.contact
        return type(self)(self.step[rows], self.span_s[rows], self.window[rows], self.contact[rows])

    def overlaps(self, e: Floats, others: Floats) -> Complexes:
        """Integrals of ``exp(i (others - e) t)`` over each step, ``e`` (n, a) and ``others`` (n, b): (n, a, b), s."""
        e, others = np.ascontiguousarray(e), np.ascontiguousarray(others)
        out = np.zeros((len(e), e.shape[1], others.shape[1]), dtype=np.complex128)
        _overlaps(self.step, self.span_s, e, others, out)
        return out

    def gram(self, e: Floats, fitted: Bools) -> Complexes:
        """Normal equations (n, a, a) of a fit of those exponentials ``e`` (n, a) that are ``fitted``."""
        return self.overlaps(e, e) * (fitted[:, :, None] & fitted[:, None, :])

    def projected(self, gram: Complexes, e: Floats, others: Floats) -> Complexes:
        """Least-squares projections of exponentials ``others`` (n, b) on those of ``e`` (n, a) that ``gram`` fits.

        Angular frequencies in rad/s. Shape (n, a, b), zero for what is not fitted.
        """
        fitted = np.diagonal(gram, axis1=1, axis2=2) != 0.0
        return solved(gram, self.overlaps(e, others) * fitted[:, :, None])


def solved(gram: Complexes, side: Complexes) -> Complexes:
    """Solutions of normal equations (n, a, a) with right sides (n, a, b); undetermined unknowns are zero."""
    size = np.sqrt(np.abs(np.diagonal(gram, axis1=1, axis2=2)))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    scaled = gram * scale[:, :, None] * scale[:, None, :] + RIDGE * np.eye(gram.shape[1])
    return np.asarray(scale[..., None] * solve(scaled, scale[..., None] * side))


@njit()
def _alike(keep, window, contact):  # type: ignore[no-untyped-def]
    """First and last but one of every run of fitted values with one window and one state of contact, (r, 2)."""
    bounds, found = np.empty((keep.shape[0], 2), dtype=np.int64), 0
    for i in range(keep.shape[0]):
        if not keep[i]:
            continue
        new = i == 0 or not keep[i - 1] or window[i] != window[i - 1] or contact[i] != contact[i - 1]
        if new:
            bounds[found, 0] = i
            found += 1
        bounds[found - 1, 1] = i + 1
    return bounds[:found].copy()


@njit(error_model="numpy")
def _overlaps(step, span_s, e, others, out):  # type: ignore[no-untyped-def]
    """Add the intervals' integrals to ``out`` (n, a, b), from the exponentials at both ends."""
    a, b = e.shape[1], others.shape[1]
    ends, starts = np.empty((2, a), dtype=np.complex128), np.empty((2, b), dtype=np.complex128)
    for r in range(step.shape[0]):
        n, length, middle = step[r], span_s[r, 1] - span_s[r, 0], 0.5 * (span_s[r, 0] + span_s[r, 1])
        for end in range(2):
            for i in range(a):
                ends[end, i] = np.exp(-1j * e[n, i] * span_s[r, end])
            for j in range(b):
                starts[end, j] = np.exp(1j * others[n, j] * span_s[r, end])
        for i in range(a):
            for j in range(b):
                difference = others[n, j] - e[n, i]
                # two exponentials that differ by less than 1e-4 rad over the interval: the quotient below would lose
                # its digits
                if abs(difference) * length < 1e-4:
                    out[n, i, j] += length * np.exp(1j * difference * middle)
                else:
                    turned = starts[1, j] * ends[1, i] - starts[0, j] * ends[0, i]
                    out[n, i, j] += turned / (1j * difference)


def signed_frequencies(omega: Floats) -> Floats:
    """Angular frequencies of a constant and of tones (n, k) with both signs, (n, 2 k + 1)."""
    return np.column_stack([np.zeros(len(omega)), omega, -omega])


def in_both_senses(fitted: Bools) -> Bools:
    """Which of the `signed_frequencies` are fitted, the constant first, from which tones (n, k) are, (n, 2 k + 1)."""
    return np.column_stack([np.ones(len(fitted), dtype=np.bool_), fitted, fitted])


def modulated_projection(up: Complexes, down: Complexes, phase: Floats) -> Complexes:
    """Projections of tones times ``sin(w t + phase)``, from those shifted up and down by w, (n, a, b)."""
    rotation = np.exp(1j * phase)[:, None, None]
    return np.asarray((rotation * up - np.conj(rotation) * down) / 2j)


def shifted_down(up: Complexes) -> Complexes:
    """Projections (n, 2 a, 2 b) of both signs of tones, shifted down by as much as they are shifted ``up``.

    Every frequency changes its sign: the signs change places, and projections are conjugate.
    """
    return np.conj(np.roll(up, (up.shape[1] // 2, up.shape[2] // 2), axis=(1, 2)))


def two_sided(z: Complexes) -> Complexes:
    """Amplitudes of real tones (n, k) at both signs of their frequencies, (n, 2 k)."""
    return np.asarray(np.concatenate([z, np.conj(z)], axis=1) / 2.0)


def mean_phasor(span_s: Floats, w: Floats) -> Complexes:
    """Mean of ``exp(i w t)`` over intervals (n, 2) at each of ``w`` (f,), (f, n)."""
    middle, half = span_s.mean(axis=1), 0.5 * np.diff(span_s, axis=1)[:, 0]
    return np.asarray(np.exp(1j * w[:, None] * middle) * np.sinc(w[:, None] * half / np.pi))


HARMONICS = 5
MASK_PARTS = (0.25, 0.35, 0.5, 0.7, 1.0)  # lengths of the masks after an impact, as parts of the longest
N_MASK_LEVELS = len(MASK_PARTS) + 1  # a block's mask level is the number of masks that it is clear of
CONTACT, NEITHER, FLIGHT = range(3)
N_BLOCK_CLASSES = 3 * N_MASK_LEVELS


def multiples_of(forcing: tuple[int, ...]) -> tuple[int, ...]:
    """Multiples that are fitted to a ``forcing`` of some: those to `HARMONICS`, and what its squares and cubes hold."""
    turns = {0, *forcing, *(-m for m in forcing)}  # sums of three: a bend of the plate mixes its tones
    products = {abs(a + b + c) for a, b, c in itertools.combinations_with_replacement(turns, 3)} - {0}
    return tuple(sorted(set(range(1, HARMONICS + 1)) | products))


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


class DriveReading(NamedTuple):
    """What the drive's reading can show in a step."""

    cut_off: bool = False  # whether it is at its end for a part of each cycle
    step_v: float = 0.0  # of its converter; 0 where none is seen


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
    drive_reads: DriveReading = field(default_factory=DriveReading)

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
