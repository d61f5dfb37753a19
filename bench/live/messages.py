"""What goes to a browser: binary pieces of the scope, of flights and of the spectrum, little-endian."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernels.arrays import Floats

SCOPE, FLIGHTS, SPECTRUM = 1, 2, 3


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
