"""Noise in measured tones beyond the white noise that a fit's residual tells: coloured noise, and undithered rounding.

Semiconductor sensors and charge amplifiers have noise that rises towards low frequencies. It shows in the phases of a
tone from window to window, beyond those of the drive; an amplitude modulation does not change them. What all steps
together tell of it widens every uncertainty of the tone, and where chance may do it, nothing is changed.

The rounding error of a periodic signal is periodic itself: it does not average out over cycles, but stands in the
tones. Noise of half a step makes it random.

References
----------
R. M. Gray, IEEE Trans. Inf. Theory 36, 1220 (1990): spectra of the error of a rounded sine.
B. Widrow, I. Kollar, Quantization Noise (Cambridge, 2008), ch. 19: dither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.plate.motion import StepPlate
from analysis.statistics import median
from daq.lock_in import ToneFit


def with_coloured_noise(steps: Sequence[StepPlate | None]) -> tuple[StepPlate | None, ...]:
    """Steps with the uncertainties of the forcing's tones as large as their phases in windows scatter."""
    fitted = [s for s in steps if s is not None]
    tones = max((len(s.forcing_multiples) for s in fitted), default=1)
    squares = np.zeros((tones, 2))  # by forcing tone: sum of squares, and degrees of freedom
    for s in fitted:
        for t in range(len(s.forcing_multiples)):
            squares[t] += _phase_scatter(s, t)
    factors = [_factor(square, freedom) for square, freedom in squares]
    if max(factors) == 1.0:
        return tuple(steps)
    return tuple(None if s is None else _widened(s, factors[: len(s.forcing_multiples)]) for s in steps)


def _factor(square: float, freedom: float) -> float:
    """How many times larger an uncertainty is than white noise makes it; 1 where chance may do it."""
    # four sigma of chi square: below, the phases scatter as white noise makes them
    if square <= freedom + 4.0 * math.sqrt(2.0 * freedom):
        return 1.0
    return math.sqrt(square / freedom)


def _phase_scatter(s: StepPlate, t: int) -> tuple[float, int]:
    """Sum of squares of forcing tone ``t``'s phases about a straight line, in units of their noise, and its freedom."""
    w, row = s.windows, s.multiples.index(s.forcing_multiples[t])
    z = s.acceleration.amplitudes[row]
    phase, variance = (w.amplitudes[:, t] / z).imag, (w.uncertainty_mps2[:, t] / abs(z)) ** 2
    if s.drive is not None and (v := s.drive.amplitudes[row]) != 0.0:
        phase = phase - (w.drive_v[:, t] / v).imag
        variance = variance + (w.drive_uncertainty_v[:, t] / abs(v)) ** 2
    seen = np.isfinite(phase) & (variance > 0.0)
    # a step of fewer than four windows says little of the scatter from window to window
    if np.count_nonzero(seen) < 4:
        return 0.0, 0
    time_s, phase, weight = w.time_s[seen], phase[seen], 1.0 / variance[seen]
    total = weight.sum()
    time_s, phase = time_s - weight @ time_s / total, phase - weight @ phase / total
    pull = weight * time_s
    left = phase - time_s * (pull @ phase / (pull @ time_s))
    return float(weight @ left**2), len(left) - 2


def _widened(s: StepPlate, factors: Sequence[float]) -> StepPlate:
    """The step with each forcing tone's uncertainties multiplied by its factor."""
    every = np.ones(2 * len(s.acceleration.amplitudes))
    for multiple, factor in zip(s.forcing_multiples, factors, strict=True):
        row = s.multiples.index(multiple)
        every[2 * row : 2 * row + 2] = factor
    return replace(
        s,
        acceleration=replace(s.acceleration, covariance=s.acceleration.covariance * np.outer(every, every)),
        contact_flight=replace(s.contact_flight, rms_v=s.contact_flight.rms_v * factors[0]),
        gamma_uncertainty=s.gamma_uncertainty * factors[0],
        windows=replace(s.windows, uncertainty_mps2=s.windows.uncertainty_mps2 * factors),
    )


def converter_step(values: NDArray[Any]) -> float:
    """Distance of neighbouring values of a rounded signal, codes or volts; 0 where they do not show one."""
    in_order = np.sort(values)
    different = in_order[np.append(True, in_order[1:] != in_order[:-1])]
    # each value must come four times on average, before the distances of values show a converter's step
    if different.size < 2 or 4 * different.size > len(values):
        return 0.0
    distances = np.diff(different.astype(np.float64))
    step = median(distances)
    # a drive without noise has few values, too, the same in each cycle: they lie on no lattice
    steps = distances / step
    return step if np.mean(np.abs(steps - np.rint(steps)) < 0.1) > 0.9 else 0.0


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
