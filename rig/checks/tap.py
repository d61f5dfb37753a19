"""The slow mode of a table from one tap: the table rests, is hit once, and rings as it is damped."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import least_squares

from kernels.arrays import Floats

LOWEST_HZ, HIGHEST_HZ = 0.7, 200.0


def mode_of_tap(acceleration: Floats, rate_hz: float) -> tuple[float, float] | None:
    """Frequency in Hz and damping over critical of the mode that rings longest after a tap; None where none is seen.

    ``acceleration`` (n,) is in any unit, from before the tap on.
    """
    # block means at 1 kHz: far above any mode that a ball shakes
    width = max(round(rate_hz / 1000.0), 1)
    x = acceleration[: len(acceleration) // width * width].reshape(-1, width).mean(axis=1)
    block_s = width / rate_hz
    away = np.abs(acceleration - np.median(acceleration))
    # a tap stands out of the noise by twenty times; of an input that stands still nothing does
    if not np.max(away) > 20.0 * 1.4826 * np.median(away):
        return None
    first = int(np.argmax(away)) // width + round(0.02 / block_s)  # the hammer itself is over
    x = x[first : first + round(4.0 / block_s)]
    if len(x) < round(2.0 / LOWEST_HZ / block_s):
        return None
    time_s = np.arange(len(x)) * block_s
    x = x - np.mean(x[len(x) // 2 :])  # the end is the zero: it has rung out
    hz = np.fft.rfftfreq(8 * len(x), block_s)
    inside = (hz > LOWEST_HZ) & (hz < HIGHEST_HZ)
    start_hz = float(hz[inside][np.argmax(np.abs(np.fft.rfft(x, 8 * len(x)))[inside])])

    def left(p: Floats) -> Floats:
        w, damping = 2.0 * math.pi * math.exp(p[0]), math.exp(p[1])
        own = np.exp((-damping + 1j * math.sqrt(1.0 - damping**2)) * w * time_s)
        shape = np.column_stack([own.real, own.imag, np.ones(len(x))])
        return np.asarray(x - shape @ np.linalg.lstsq(shape, x, rcond=None)[0])

    low, high = np.log([[LOWEST_HZ, 1e-4], [HIGHEST_HZ, 0.9]])
    fits = [
        least_squares(left, np.clip(np.log([start_hz, damping]), low, high), bounds=(low, high), x_scale=0.1)
        for damping in (0.01, 0.1)
    ]
    best = min(fits, key=lambda fit: fit.cost)
    # at least half of the power is the mode's
    if 2.0 * best.cost >= 0.5 * float(x @ x):
        return None
    return float(np.exp(best.x[0])), float(np.exp(best.x[1]))
