"""Mains line of a step at its measured frequency: mains wander, and an exact 50 or 60 Hz would miss part of the motion.

A line's frequency is refined only where its amplitude is significant in the noise near it, starting from the steps
before. That noise and the remaining frequency uncertainty are part of the covariance of the tones. Transformers and
rectifiers add multiples of the mains: where a line has been measured, its multiples are fitted with it.
Decisions 282 and 309.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.fft import prev_fast_len

from analysis.statistics import median
from daq.lock_in import ToneFit
from kernels.arrays import Complexes, Floats

MAINS_HZ = (50.0, 60.0)
MAX_OFFSET_HZ = 0.3  # largest distance from the nominal frequency: a free-running generator, a clock that is off
PRIOR_SIGMA_HZ = 0.1  # standard deviation of a line's frequency before any measurement
SIGNIFICANT = 6.0  # amplitude over its uncertainty from which a line's frequency is refined
MIN_SEPARATION_CYCLES = 0.3  # cycles over a step by which two tones must differ: their uncertainties grow by a half
FAR_FROM = 0.5  # part of a significant amplitude below which a line is not fitted at other frequencies
LOBE = 0.25  # cycles over a step by which a line may be off and still be found from its start
BIN_S = 0.2  # bin of a long step's search, short against a beat of `MAX_OFFSET_HZ`


@dataclass(frozen=True)
class MainsLine:
    """Mains line: nominal frequency, measured frequency with its uncertainty, and the time of the measurement.

    ``slopes`` (k,) are the changes of all the step's fitted tones with the line's frequency; None: not measured.
    ``near_power`` is the power of the noise near it in all steps so far, over that of white noise of the same rms,
    summed over ``near_bins`` bins of periodograms.
    """

    nominal_hz: float
    hz: float
    sigma_hz: float
    at_s: float
    slopes: Complexes | None = None
    near_power: float = 0.0
    near_bins: int = 0

    def later(self, at_s: float) -> MainsLine:
        """Prior of the line in another step: the uncertainty grows as a random walk."""
        # the mains frequency walks by 2 mHz within a second
        sigma = float(np.hypot(self.sigma_hz, 0.002 * np.sqrt(abs(at_s - self.at_s))))
        return replace(self, sigma_hz=min(sigma, PRIOR_SIGMA_HZ), at_s=at_s, slopes=None)

    @property
    def multiples_hz(self) -> list[float]:
        """Multiples that are fitted with the line: none where no step has shown it."""
        # hum is no sine: transformers and rectifiers make its harmonics
        return [k * self.hz for k in (2, 3, 4, 5, 6, 7)] if self.sigma_hz < PRIOR_SIGMA_HZ else []

    @property
    def noise(self) -> float:
        """Noise near the line, as a multiple of white noise of the residual's size; no less than that."""
        return math.sqrt(max(self.near_power, self.near_bins) / self.near_bins) if self.near_bins else 1.0

    def with_noise(self, near: Floats) -> MainsLine:
        """The line with the noise near it in another chunk, a row of `noise_near`."""
        return replace(self, near_power=self.near_power + float(near[0]), near_bins=self.near_bins + int(near[1]))

    @property
    def reach_hz(self) -> float:
        """Half width of the search around `hz`."""
        return min(3.0 * self.sigma_hz, MAX_OFFSET_HZ)


def noise_near(residual: Floats, cycles: Floats, first: int, rate_hz: float) -> Floats:
    """Power of a residual near its tones from number ``first`` on, over that of white noise of its size, times bins.

    Returns that power, and the number of bins of the periodogram that it was measured in: their median, so that other
    lines do not count.

    Parameters
    ----------
    residual
        Blocks of a chunk (n,) less all tones, 0 where they are masked.
    cycles
        Frequencies of the tones (k,), a block.
    first, rate_hz
        The first mains line among the tones, and blocks a second.
    """
    out = np.zeros((cycles.size - first, 2))
    # of a length with a large prime factor the transform takes ten times as long
    residual = residual[: prev_fast_len(max(residual.size, 1), real=True)]
    size, spectrum = residual.size, np.fft.rfft(residual)
    white = float(residual @ residual)
    for line, own in enumerate(cycles[first:] * size if white > 0.0 else []):
        # noise within 10 Hz of a line is the line's own
        reach = 10.0 / rate_hz * size
        bins = np.arange(max(math.ceil(own - reach), 1), min(int(own + reach) + 1, spectrum.size))
        # within 1.5 bins of a tone a periodogram shows the tone
        bins = bins[np.abs(bins[:, None] - cycles * size).min(axis=1) > 1.5] if bins.size else bins
        if bins.size:
            power = np.abs(spectrum[bins]) ** 2
            out[line] = median(power) / math.log(2.0) / white * bins.size, bins.size
    return out


def with_line_uncertainty(fit: ToneFit, lines: Sequence[MainsLine], factor: float) -> ToneFit:
    """The fit with the noise near the lines and their frequencies' uncertainties in its covariance.

    ``factor`` is that from volts to the fit's unit.
    """
    for line in lines:
        if line.noise > 1.0:
            lines_hz = {line.hz, *line.multiples_hz}
            own = np.repeat([hz in lines_hz for hz in fit.frequencies_hz.tolist()], 2)
            wider = np.where(own, line.noise, 1.0)
            fit = replace(fit, covariance=fit.covariance * np.outer(wider, wider))
        if line.slopes is not None:
            both = np.zeros(len(fit.covariance))  # multiples may have come to the fit since
            slopes = np.column_stack([line.slopes.real, line.slopes.imag]).ravel()[: len(both)]
            both[: len(slopes)] = slopes * line.sigma_hz * factor
            fit = replace(fit, covariance=fit.covariance + np.outer(both, both))
    return fit


def unmeasured_line(nominal_hz: float) -> MainsLine:
    """Prior of a line at its nominal frequency."""
    return MainsLine(nominal_hz, nominal_hz, PRIOR_SIGMA_HZ, 0.0)


def separable_lines(lines_hz: Sequence[float], tones_hz: Floats, length_s: float) -> list[float]:
    """Lines that a step of this length can separate from its tones."""
    long_enough = [hz for hz in lines_hz if hz * length_s > 5.0]  # cycles
    return [hz for hz in long_enough if np.abs(tones_hz - hz).min() > MIN_SEPARATION_CYCLES / length_s]


def strongest_hz(demodulated: Complexes, line: MainsLine, length_s: float) -> tuple[float, float]:
    """Frequency near the line's at which the residual of a long step is strongest, and how strong it is there.

    ``demodulated`` are its sums over successive bins of `BIN_S`, times ``exp(-2 pi i f t)`` of the line, in any unit.
    """
    off_hz, turns = _trials(math.ceil(line.reach_hz * length_s / LOBE), length_s, len(demodulated))
    strength = np.abs(turns @ demodulated)
    at = int(np.argmax(strength))
    return float(line.hz + off_hz[at]), float(strength[at])


@lru_cache(maxsize=2)
def _trials(count: int, length_s: float, bins: int) -> tuple[Floats, Complexes]:
    """Frequencies (2 ``count`` + 1,) off a line's at which a long step is looked at, and the turns back of its bins."""
    off_hz = np.asarray(np.arange(-count, count + 1) * LOBE / length_s, dtype=np.float64)
    middles_s = (np.arange(bins) + 0.5) * BIN_S
    return off_hz, np.exp(-2j * np.pi * off_hz[:, None] * middles_s)


def is_absent(fit: ToneFit, place: int, line: MainsLine, demodulated: Complexes, length_s: float) -> bool:
    """Whether a line is far from significant at every frequency in its reach, without a fit there.

    Its amplitude elsewhere is estimated with the other tones held fast. Where they are more than a cycle over the step
    away, that is right to a small part, for which `FAR_FROM` leaves room. ``demodulated`` is as for `strongest_hz`:
    the accelerometer in volts less all tones but the line, which is in row ``place`` of the ``fit``.
    """
    quadratures = fit.covariance.diagonal()[2 * place : 2 * place + 2]
    limit = FAR_FROM * SIGNIFICANT * line.noise * math.sqrt(0.5 * (quadratures[0] + quadratures[1]))
    if not abs(fit.amplitudes[place]) < limit:
        return False
    if length_s * line.reach_hz <= LOBE:
        return True
    distance_hz = np.abs(fit.frequencies_hz - line.hz)
    distance_hz[place] = np.inf
    if not (float(np.minimum.reduce(distance_hz)) - line.reach_hz) * length_s > 1.0:
        return False
    return 2.0 * strongest_hz(demodulated, line, length_s)[1] < limit * fit.n


def refined_line(
    line: MainsLine,
    place: int,
    fit_at: Callable[[float], ToneFit],
    begin_hz: float,
    others_hz: Floats,
    length_s: float,
) -> MainsLine:
    """The line at the maximum of its posterior: Gauss-Newton steps of the fit's misfit plus the Gaussian prior.

    Parameters
    ----------
    line
        Prior; returned unchanged where the line is not significant or comes too near another tone.
    place
        Row of the line among the fitted tones.
    fit_at
        Fit of all tones with the line at a given frequency, in volts.
    begin_hz
        Start of the iteration.
    others_hz
        All other tones of the step, shape (k - 1,).
    length_s
        Length of the step.
    """
    # trials a tenth of a cycle over the step from each other: the misfit is a parabola there
    hz, h = begin_hz, 0.1 / length_s
    for _ in range(8):
        middle = fit_at(hz)
        if not abs(middle.amplitudes[place]) > SIGNIFICANT * line.noise * middle.amplitude_sigma()[place]:
            return line
        left, right = fit_at(hz - h), fit_at(hz + h)
        misfit = [_misfit(f) / max(middle.rms**2, 1e-300) for f in (left, middle, right)]
        curvature = max((misfit[0] - 2.0 * misfit[1] + misfit[2]) / h**2, 0.0) + 2.0 / line.sigma_hz**2
        slope = (misfit[2] - misfit[0]) / (2.0 * h) + 2.0 * (hz - line.hz) / line.sigma_hz**2
        step = float(np.clip(-slope / curvature, -2.0 * h, 2.0 * h))
        hz += step
        if abs(hz - line.nominal_hz) > MAX_OFFSET_HZ or np.abs(others_hz - hz).min() < MIN_SEPARATION_CYCLES / length_s:
            return line
        sigma = float(np.sqrt(2.0 / curvature))
        # the last step is a tenth of the uncertainty: more steps would not be seen
        if abs(step) < 0.1 * sigma:
            return replace(line, hz=hz, sigma_hz=sigma, slopes=(right.amplitudes - left.amplitudes) / (2.0 * h))
    return line


def _misfit(fit: ToneFit) -> float:
    """Residual sum of squares of a fit."""
    return fit.rms**2 * (fit.n - 2 * len(fit.amplitudes) - 1)
