"""A coupling's high-pass in the accelerometer, undone where impacts are found and taken away, then put back.

Behind a high-pass of corner ``f`` an impact whose acceleration has the integral ``J`` leaves a tail
``-2 pi f J exp(-2 pi f t)``, which outlasts any mask. Restored, it ends with the impact: what is taken away then is the
whole impact, and the high-pass that is put back makes no tail of it. Tones and noise come out as they were recorded.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import bilinear, detrend, lfilter

from analysis.signals.stream import Piece, Volts
from kernels.arrays import Floats

LEAST_HZ = 1.0  # corner from which tails of impacts matter


def restored(acceleration: Floats, corner_hz: float, rate_hz: float) -> Floats:
    """Acceleration (n,) of a plate that goes nowhere, before a high-pass of first order, less a line."""
    own = acceleration - acceleration.mean()
    return np.asarray(detrend(own + 2.0 * np.pi * corner_hz / rate_hz * (np.cumsum(own) - 0.5 * own)))


class HighPass:
    """The high-pass of successive pieces of a recording.

    Parameters
    ----------
    corner_hz : float
        Of a high-pass of first order.
    rate_hz : float
    """

    def __init__(self, corner_hz: float, rate_hz: float) -> None:
        w = 2.0 * np.pi * corner_hz
        # below 5 % of the corner nothing is restored: noise and bias would grow without end
        b, a = bilinear([1.0, w], [1.0, 0.05 * w], fs=rate_hz)
        self._undo, self._redo = (b / a[0], a / a[0]), (a / b[0], b / b[0])
        self._undone, self._redone = np.zeros(1), np.zeros(1)
        self._before: Volts | None = None

    def undo(self, piece: Piece) -> None:
        """Restore channel ``accelerometer`` of a piece and its neighbours in place; pieces come in order."""
        volts, pad = piece.channels["accelerometer"], piece.pad
        if self._before is None:
            volts[:pad], self._undone = self._filtered(self._undo, volts[:pad], self._undone)
            self._redone = self._filtered(self._redo, volts[:pad], self._redone)[1]
        else:
            volts[:pad] = self._before
        own, self._undone = self._filtered(self._undo, piece.own("accelerometer"), self._undone)
        after, _ = self._filtered(self._undo, volts[pad + piece.count :], self._undone)
        volts[pad : pad + piece.count], volts[pad + piece.count :] = own, after
        self._before = volts[piece.count : piece.count + pad].copy()

    def redo(self, piece: Piece) -> None:
        """Put the high-pass back into a piece that `undo` restored, in place, its neighbours left out."""
        own, self._redone = self._filtered(self._redo, piece.own("accelerometer"), self._redone)
        piece.own("accelerometer")[:] = own

    @staticmethod
    def _filtered(of: tuple[Floats, Floats], volts: Volts, state: Floats) -> tuple[Floats, Floats]:
        out, state = lfilter(*of, volts.astype(np.float64), zi=state)
        return out, state
