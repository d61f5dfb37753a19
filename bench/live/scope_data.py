"""What goes to a browser: extremes of the signals for its scope, and binary pieces of scope, flights and spectrum.

The extremes of every few samples show a signal on a screen without losing a spike. Pieces are little-endian.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import sosfilt

from daq.pyramid import empty_extremes, fold_samples
from kernels.arrays import Floats

Codes = NDArray[np.int16]

MOST_BINS_PER_S = 20_000.0  # sent to a page: 50 us each, below which nothing of a bounce is to be seen


class MinMax:
    """Extremes of successive bins of ``n_bin`` samples of all channels, whatever pieces the samples come in."""

    def __init__(self, n_bin: int, channels: int) -> None:
        self._n_bin, self._channels = n_bin, channels
        self._filled = 0  # samples of the bin begun
        self._begun = empty_extremes(channels, np.dtype(np.int16))  # its minima and maxima
        self.add(np.zeros((1, channels), np.int16))  # compiled before a run needs it
        self.clear()

    def add(self, codes: Codes) -> Codes:
        """Extremes of the bins that these codes (n, channels) complete: (k, 2, channels), minimum first."""
        bins, filled = divmod(self._filled + len(codes), self._n_bin)
        folded = []
        for c, column in enumerate(np.ascontiguousarray(codes.T)):
            extremes = empty_extremes(bins + 1, codes.dtype)
            for begun, found in zip(self._begun, extremes, strict=True):
                found[0] = begun[c]
            fold_samples(column, self._filled, self._n_bin, *extremes)
            folded.append(extremes)
        self._filled = filled
        out = np.moveaxis(np.array(folded, codes.dtype), 0, -1)  # (2, bins + 1, channels): the last bin is begun
        self._begun = out[0, -1].copy(), out[1, -1].copy()
        return np.ascontiguousarray(np.swapaxes(out[:, :-1], 0, 1))

    def clear(self) -> None:
        """Leave out the bin begun: samples are missing."""
        self._filled = 0
        self._begun = empty_extremes(self._channels, np.dtype(np.int16))


class PlateHeight:
    """Displacement of the plate from its accelerometer, as codes of ``least_m`` metres: one more trace of the scope.

    Acceleration is integrated twice; what is slower than a tenth of the forcing is forgotten.
    """

    def __init__(self, rate_hz: float, frequency_hz: float, mps2_per_code: float, least_m: float) -> None:
        leak, dt = 2.0 * np.pi * 0.1 * frequency_hz / rate_hz, 1.0 / rate_hz
        # twice a leaky integral, and a high-pass before and after: an offset and its drift would grow without bound
        section = [dt * (1.0 - leak), dt * (leak - 1.0), 0.0, 1.0, 2.0 * (leak - 1.0), (1.0 - leak) ** 2]
        self._sections, self._state = np.array([section, section]), np.zeros((2, 2))
        self._scale = mps2_per_code / least_m

    def add(self, codes: Codes) -> Codes:
        """Displacement at each of the accelerometer's codes (n,), as codes."""
        height, self._state = sosfilt(self._sections, codes * self._scale, zi=self._state)
        out: Codes = np.clip(height, -32767.0, 32767.0).astype(np.int16)
        return out


SCOPE, FLIGHTS, SPECTRUM = range(1, 4)  # kinds of message


def scope_piece(first_s: float, bin_s: float, extremes: NDArray[np.int16]) -> bytes:
    """Bins (k, 2, traces) of the scope from time ``first_s`` on: header of 24 bytes, then minima and maxima."""
    head = struct.pack("<BBHIdd", SCOPE, extremes.shape[2], 0, len(extremes), first_s, bin_s)
    return head + np.ascontiguousarray(extremes, "<i2").tobytes()


def flights_piece(message: dict[str, Any], factor: float) -> bytes:
    """A step's flights: header of 16 bytes, then columns of float32 and the marks.

    Flight time (ms), landing since the step's first sample (s), residual and its uncertainty (us), mark (uint8).
    ``factor``: gamma as shown over gamma.
    """
    duration, landing, residual, noise, mark = message["columns"]
    gamma = message["gamma"] if np.isfinite(message["gamma"]) else message["asked"]
    head = struct.pack("<BBHIff", FLIGHTS, message["final"], message["step"], len(duration), gamma * factor, 0.0)
    columns = (1e3 * duration, landing, 1e6 * residual, 1e6 * noise)
    return head + b"".join(np.asarray(x, "<f4").tobytes() for x in columns) + np.asarray(mark, np.uint8).tobytes()


def spectrum_piece(rate_hz: float, acceleration_mps2: Floats) -> bytes:
    """Amplitude spectral density of the accelerometer, (m/s^2)/sqrt(Hz), in bins of even width in the logarithm.

    Header of 8 bytes, then frequencies and the largest density in each bin, float32.
    """
    n = len(acceleration_mps2)
    window = np.hanning(n)
    power = np.abs(np.fft.rfft((acceleration_mps2 - acceleration_mps2.mean()) * window)) ** 2
    density = np.sqrt(2.0 * power / (rate_hz * np.sum(window**2)))[1:]
    frequency = np.arange(1, len(density) + 1) * rate_hz / n
    edges = np.unique(np.searchsorted(frequency, np.geomspace(frequency[0], frequency[-1], 400)))
    largest = np.maximum.reduceat(density, edges)
    head = struct.pack("<BBHI", SPECTRUM, 0, 0, len(edges))
    return head + np.asarray(frequency[edges], "<f4").tobytes() + np.asarray(largest, "<f4").tobytes()
