"""Minimum and maximum of every few samples, piece by piece: what a screen shows of a signal without losing a spike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kernels import njit
from kernels.arrays import Floats

Codes = NDArray[np.int16]

MOST_BINS_PER_S = 20_000.0  # sent to a page: 50 us each, below which nothing of a bounce is to be seen


def bin_for(rate_hz: float) -> int:
    """Samples of a bin at a sampling rate."""
    return max(1, int(np.ceil(rate_hz / MOST_BINS_PER_S)))


class MinMax:
    """Extremes of successive bins of ``n_bin`` samples, whatever pieces the samples come in.

    Parameters
    ----------
    n_bin, channels
        Samples of a bin, and columns of a frame.
    """

    def __init__(self, n_bin: int, channels: int) -> None:
        self._n_bin = n_bin
        self._state = np.zeros((2, channels), np.int16)  # minimum and maximum of the bin begun
        self._filled = 0
        _extremes(np.zeros((1, channels), np.int16), n_bin, 0, self._state.copy(), np.zeros((2, 2, channels), np.int16))

    def add(self, codes: Codes) -> Codes:
        """Extremes of the bins that these codes (n, channels) complete: (k, 2, channels), minimum first."""
        out = np.empty(((self._filled + len(codes)) // self._n_bin, 2, codes.shape[1]), np.int16)
        self._filled = _extremes(codes, self._n_bin, self._filled, self._state, out)
        return out

    def clear(self) -> None:
        """Leave out the bin begun: samples are missing."""
        self._filled = 0


@njit()
def _extremes(codes: Codes, n_bin: int, filled: int, state: Codes, out: Codes) -> int:
    """Fill ``out`` and ``state``; returns the samples of the bin begun."""
    k = 0
    for i in range(codes.shape[0]):
        for c in range(codes.shape[1]):
            x = codes[i, c]
            if filled == 0 or x < state[0, c]:
                state[0, c] = x
            if filled == 0 or x > state[1, c]:
                state[1, c] = x
        filled += 1
        if filled == n_bin:
            for c in range(codes.shape[1]):
                out[k, 0, c] = state[0, c]
                out[k, 1, c] = state[1, c]
            k += 1
            filled = 0
    return filled


class PlateHeight:
    """Displacement of the plate from its accelerometer, as codes of `LEAST_M` metres: one more trace of the scope.

    Acceleration is integrated twice; what is slower than a tenth of the forcing is forgotten.

    Parameters
    ----------
    rate_hz, frequency_hz
        Of sampling, and of the first tone.
    mps2_per_code, least_m
        Scale of the accelerometer's codes, and of the result's.
    """

    def __init__(self, rate_hz: float, frequency_hz: float, mps2_per_code: float, least_m: float) -> None:
        self._constants = np.array([1.0 / rate_hz, 2.0 * np.pi * 0.1 * frequency_hz / rate_hz, mps2_per_code, least_m])
        self._state = np.zeros(4)
        self.add(np.zeros(1, np.int16))
        self._state[:] = 0.0

    def add(self, codes: Codes) -> Codes:
        """Displacement at each of the accelerometer's codes (n,), as codes."""
        out = np.empty(len(codes), np.int16)
        _integrate(codes, self._constants, self._state, out)
        return out


@njit()
def _integrate(codes: Codes, constants: Floats, state: Floats, out: Codes) -> None:
    """``state``: slow part of the acceleration, velocity, displacement, slow part of the displacement."""
    dt, leak, scale, least = constants
    rest, v, x, slow = state
    for i in range(codes.size):
        a = codes[i] * scale
        rest += leak * (a - rest)
        v += (a - rest) * dt - leak * v
        x += v * dt - leak * x
        slow += leak * (x - slow)
        out[i] = min(max((x - slow) / least, -32767.0), 32767.0)
    state[0] = rest
    state[1] = v
    state[2] = x
    state[3] = slow
