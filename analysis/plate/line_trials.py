"""Fits of a step with one of its tones at trial frequencies.

Only the moved tone's two rows of the normal equations are computed anew.
"""

from __future__ import annotations

import numpy as np

from analysis.plate.mains_lines import BIN_S
from analysis.plate.step_state import N_MASK_LEVELS, StepState
from daq.lock_in import ToneFit, boxcar_response, inverse_of, solved
from daq.lock_in_kernel import turns
from kernels import njit
from kernels.arrays import Complexes, Floats

STRETCH = 64  # blocks between exact restarts of the rotating phasors, at most


class LineTrials:
    """Accelerometer blocks outside the mask of an open step, and the phasors of its tones there.

    Attributes
    ----------
    values : array, shape (n,)
        Volts of the blocks outside the mask.
    blocks : int array, shape (n,)
        Their numbers.
    """

    def __init__(self, state: StepState, rate_hz: float) -> None:
        if state.lock_in is None:
            raise ValueError("wanted a step whose normal equations are accumulated")
        sums = state.lock_in.part(state.clear_classes())
        self._rate_hz, self._boxcar = rate_hz, sums.boxcar
        self._frequencies_hz, self._n = sums.frequencies_hz.copy(), sums.n
        self._gram, self._side = sums.gram, sums.rhs[:, 0]
        room, found = sum(len(span.values) for span in state.spans), 0
        values, blocks = np.empty(room), np.empty(room, dtype=np.int64)
        for span in state.spans:
            found = _gather(span.values, span.block_class, span.first, state.mask_level, values, blocks, found)
        self.values, self.blocks = values[:found], blocks[:found]
        self._square = float(self.values @ self.values)
        self._bins = ((self.blocks / rate_hz - self.blocks[0] / rate_hz) / BIN_S).astype(np.int64)
        self._rows = np.empty((self._side.size, self.values.size))
        self._rows[0] = 1.0
        _fill_rows(self._frequencies_hz / rate_hz, state.lock_in.response(), self.blocks, self._rows[1:])

    def residual(self, fit: ToneFit, tone: int) -> Floats:
        """Volts (n,) less the constant and all tones of ``fit`` but number ``tone``."""
        unknowns = np.empty(len(self._rows))
        unknowns[0], unknowns[1::2], unknowns[2::2] = fit.offset, fit.amplitudes.real, fit.amplitudes.imag
        unknowns[2 * tone + 1 : 2 * tone + 3] = 0.0
        return np.asarray(self.values - unknowns @ self._rows)

    def demodulated(self, fit: ToneFit, tone: int) -> Complexes:
        """Sums over bins of `BIN_S` of the residual demodulated at tone ``tone``, the blocks' gain and delay in it."""
        residual, at = self.residual(fit, tone), 2 * tone + 1
        sums = np.zeros(self._bins[-1] + 1, dtype=np.complex128)
        _demodulate(residual, self._rows[at], self._rows[at + 1], self._bins, sums)
        return sums

    def fit_at(self, place: int, frequency_hz: float) -> ToneFit:
        """The accelerometer's fit with tone number ``place`` at another frequency."""
        gram, side, _ = self._moved(place, frequency_hz)
        frequencies_hz = self._frequencies_hz.copy()
        frequencies_hz[place] = frequency_hz
        return solved(frequencies_hz, inverse_of(gram, self._n, frequencies_hz), side, self._square, self._n)

    def move(self, place: int, frequency_hz: float) -> None:
        """Leave tone number ``place`` at another frequency."""
        self._gram, self._side, own = self._moved(place, frequency_hz)
        self._rows[2 * place + 1 : 2 * place + 3], self._frequencies_hz[place] = own, frequency_hz

    def _moved(self, place: int, frequency_hz: float) -> tuple[Floats, Floats, Floats]:
        """Normal matrix and right side with one tone at another frequency, and its rows (2, n)."""
        frequencies_hz = np.array([frequency_hz])
        gains = boxcar_response(frequencies_hz, self._rate_hz, self._boxcar)
        gram, side, own = self._gram.copy(), self._side.copy(), np.empty((2, self.values.size))
        _move(frequencies_hz / self._rate_hz, gains, self.blocks, self.values, self._rows, place, gram, side, own)
        return gram, side, own


@njit()
def _gather(values, block_class, first, level, out, blocks, found):  # type: ignore[no-untyped-def]
    """Put the first channel of the blocks outside the mask, and their numbers, behind the ``found``; how many now."""
    for i in range(values.shape[0]):
        if block_class[i] % N_MASK_LEVELS >= level:
            out[found], blocks[found] = values[i, 0], first + i
            found += 1
    return found


@njit()
def _demodulate(x, cosine, sine, bins, sums):  # type: ignore[no-untyped-def]
    """Add the products of ``x`` (n,) with both rows of a tone to the sums of their bins."""
    for i in range(x.shape[0]):
        sums[bins[i]] += complex(x[i] * cosine[i], x[i] * sine[i])


@njit(error_model="numpy")
def _fill_rows(cycles, gains, blocks, rows):  # type: ignore[no-untyped-def]
    """Put ``gain exp(2 pi i cycles n)`` of the ``blocks`` n into ``rows`` (2k, n).

    Rows ``2 k`` and ``2 k + 1`` are the real part of tone ``k`` and the negative imaginary part.
    """
    k, n, begin = cycles.shape[0], blocks.shape[0], 0
    cosine, sine = np.empty((k, STRETCH)), np.empty((k, STRETCH))  # of the turn since the first block of a stretch
    turns(cycles, cosine, sine)
    while begin < n:
        end = begin + 1
        while end < n and blocks[end] - blocks[begin] < STRETCH:
            end += 1
        for j in range(k):
            phase = cycles[j] * blocks[begin]
            start = np.exp(2j * np.pi * (phase - np.floor(phase))) * gains[j]
            a, b = start.real, start.imag
            for i in range(begin, end):
                c, d = cosine[j, blocks[i] - blocks[begin]], sine[j, blocks[i] - blocks[begin]]
                rows[2 * j, i], rows[2 * j + 1, i] = a * c - b * d, -(a * d + b * c)
        begin = end


@njit(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _move(cycles, gains, blocks, values, rows, place, gram, side, own):  # type: ignore[no-untyped-def]
    """Put the rows of one tone into ``own`` (2, n), and their products into tone ``place`` of ``gram`` and ``side``."""
    _fill_rows(cycles, gains, blocks, own)
    at, n = 2 * place + 1, values.shape[0]
    cosine, sine = own[0], own[1]
    for j in range(rows.shape[0]):
        row, first, second = rows[j], 0.0, 0.0
        for i in range(n):
            first += cosine[i] * row[i]
            second += sine[i] * row[i]
        gram[at, j] = gram[j, at] = first
        gram[at + 1, j] = gram[j, at + 1] = second
    square, both, other, first, second = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        square += cosine[i] * cosine[i]
        both += cosine[i] * sine[i]
        other += sine[i] * sine[i]
        first += cosine[i] * values[i]
        second += sine[i] * values[i]
    gram[at, at], gram[at + 1, at + 1], side[at], side[at + 1] = square, other, first, second
    gram[at, at + 1] = gram[at + 1, at] = both
