"""What a converter's steps leave in measured tones where no noise dithers them.

The rounding error of a periodic signal is periodic itself: it does not average out over cycles, but stands in the
tones. Noise of half a step makes it random.

References
----------
R. M. Gray, IEEE Trans. Inf. Theory 36, 1220 (1990): spectra of the error of a rounded sine.
B. Widrow, I. Kollar, Quantization Noise (Cambridge, 2008), ch. 19: dither.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.statistics import median
from daq.lock_in import ToneFit


def converter_step(values: NDArray[Any]) -> float:
    """Distance of neighbouring values of a rounded signal, codes or volts; 0 where they do not show one."""
    # codes of a short range are counted one by one, which takes less time than to sort them
    if values.dtype.kind == "i" and int(values.max()) - int(values.min()) < (1 << 14):
        different = np.flatnonzero(np.bincount(values.astype(np.int64) - int(values.min())))
    else:
        different = np.unique(values)
    # each value must come four times on average, before the distances of values show a converter's step
    if different.size < 2 or 4 * different.size > len(values):
        return 0.0
    return median(np.diff(different.astype(np.float64)))


def rounding_sigma(amplitude: float, step: float, noise: float) -> float:
    """Typical error of a quadrature of each tone, in the signal's unit, from rounding to multiples of ``step``.

    The error of the tone itself is ``(2 step / pi) sum_m (-1)^m J1(2 pi m A / step) exp(-2 (pi m s / step)^2) / m``,
    that of a harmonic as large; here the envelope of the first term. ``noise`` is that of the readings, rounding
    included.
    """
    if step <= 0.0 or amplitude <= step:
        return 0.0
    left = max(noise**2 - step**2 / 12.0, 0.0)
    envelope = math.sqrt(step / (math.pi**2 * amplitude))
    return 2.0 * step / math.pi * envelope / math.sqrt(2.0) * math.exp(-2.0 * math.pi**2 * left / step**2)


def with_rounding(fit: ToneFit, step: float, noise: float) -> ToneFit:
    """The fit with the uncertainty of its tones and offset widened by what rounding leaves in them."""
    sigma = rounding_sigma(float(np.max(np.abs(fit.amplitudes), initial=0.0)), step, noise)
    if sigma == 0.0:
        return fit
    covariance = fit.covariance + sigma**2 * np.eye(len(fit.covariance))
    return replace(fit, covariance=covariance, offset_uncertainty=math.hypot(fit.offset_uncertainty, sigma))
