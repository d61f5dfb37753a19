"""Fits of a step with one of its tones at trial frequencies.

Only the moved tone's two rows of the normal equations are computed anew.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from analysis.plate.step_state import StepState
from daq.lock_in import ToneFit, boxcar_response, inverse_of, solved
from kernels import njit

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

RESYNC = 64  # blocks between exact restarts of the rotating phasors


class LineTrials:
    """Accelerometer blocks outside the mask of an open step, and the phasors of its tones there.

    Attributes
    ----------
    values, time_s : arrays, shape (n,)
        Volts of the blocks outside the mask, and their times.
    """

    def __init__(self, state: StepState, rate_hz: float) -> None:
        if state.lock_in is None:
            raise ValueError("wanted a step whose normal equations are accumulated")
        sums = state.lock_in.part(state.clear_classes())
        self._rate_hz, self._boxcar = rate_hz, sums.boxcar
        self._frequencies_hz, self._n = sums.frequencies_hz.copy(), sums.n
        self._gram, self._side = sums.gram.copy(), sums.rhs[:, 0].copy()
        self._clear = [(span, span.clear(state.mask_level)) for span in state.spans]
        self.values = np.concatenate([span.values[clear, 0] for span, clear in self._clear])
        self.time_s = np.concatenate([span.first + np.flatnonzero(clear) for span, clear in self._clear]) / rate_hz
        self._square = float(self.values @ self.values)
        self._rows = np.ones((self._side.size, self.values.size))
        self._rows[1:] = self._rows_of(self._frequencies_hz)

    def residual(self, fit: ToneFit, kept: int) -> Floats:
        """Volts (n,) less the constant and all tones of ``fit`` but number ``kept``."""
        unknowns = np.empty(len(self._rows))
        unknowns[0], unknowns[1::2], unknowns[2::2] = fit.offset, fit.amplitudes.real, fit.amplitudes.imag
        unknowns[2 * kept + 1 : 2 * kept + 3] = 0.0
        return np.asarray(self.values - unknowns @ self._rows)

    def demodulated(self, fit: ToneFit, kept: int) -> Complexes:
        """`residual` times ``exp(-2 pi i f t)`` of tone ``kept`` and the blocks' gain and delay, (n,)."""
        residual, at = self.residual(fit, kept), 2 * kept + 1
        out = np.empty(residual.size, dtype=np.complex128)
        out.real, out.imag = residual * self._rows[at], residual * self._rows[at + 1]
        return out

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
        own, at = self._rows_of(np.array([frequency_hz])), slice(2 * place + 1, 2 * place + 3)
        products = own @ self._rows.T
        products[:, at] = own @ own.T
        gram, side = self._gram.copy(), self._side.copy()
        gram[at], gram[:, at], side[at] = products, products.T, own @ self.values
        return gram, side, own

    def _rows_of(self, frequencies_hz: Floats) -> Floats:
        """Cosine and sine rows (2k, n) of tones, the blocks' gain and delay included."""
        cycles, gains = frequencies_hz / self._rate_hz, boxcar_response(frequencies_hz, self._rate_hz, self._boxcar)
        rows = np.empty((2 * len(cycles), self.values.size))
        at = 0
        for span, clear in self._clear:
            at = _fill_rows(cycles, gains, span.first, clear, at, rows)
        return rows


@njit(error_model="numpy")
def _fill_rows(cycles, gains, first, clear, at, rows):  # type: ignore[no-untyped-def]
    """Put ``gain exp(2 pi i cycles n)`` of the ``clear`` blocks ``n`` from ``first`` on into ``rows`` from ``at`` on.

    Rows ``2 k`` and ``2 k + 1`` are the real part of tone ``k`` and the negative imaginary part. Returns the column
    after the last.
    """
    end = at
    for k in range(cycles.shape[0]):
        step, phasor, end = np.exp(2j * np.pi * cycles[k]), 0j, at
        for i in range(clear.shape[0]):
            if i % RESYNC == 0:
                phase = cycles[k] * (first + i)
                phasor = np.exp(2j * np.pi * (phase - np.floor(phase))) * gains[k]
            if clear[i]:
                rows[2 * k, end], rows[2 * k + 1, end] = phasor.real, -phasor.imag
                end += 1
            phasor *= step
    return end
