"""Noise of the accelerometer as a spectrum, measured where no impact is.

A sensor, its amplifier and its converter colour the noise: a low-pass takes its upper part, semiconductors add 1/f.
What detects impacts must know the noise at the frequencies of an impact. Decision 295.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz, toeplitz
from scipy.signal import lfilter

from kernels.arrays import Bools, Floats

FRAME = 128  # samples of a periodogram
FEWEST_FRAMES, MOST_FRAMES = 8, 1024  # periodograms from which a spectrum is measured
QUIET_SHARE = 0.25  # quantile of the periodograms that the first estimate takes: most may hold an impact
FRAME_SIGMAS = 4.0  # excess of a frame's mean power, in standard deviations, from which it is left out
FRAME_SCATTER = 1.3  # standard deviation of a frame's mean power, times the root of its number of frequencies
TURNS = 4
LEAST_PART = 0.01  # least density used, as a part of the largest: there, no waveform is known well enough
SLOW_HZ = 500.0  # below, a recording holds the plate's motion as well
PREDICTED_FROM = 16  # samples from which the next one is predicted
CORE, CORE_SIGMA = 0.98, 0.9346  # part of normal deviations that is kept, and the rms of that part
TAIL = 3.0  # standard deviations from which a detector's output counts as its tail
DECAY_SIGMAS = 3.0  # significance from which a tail is heavier than that of normal noise
FALSE_PER_HOUR = 0.1  # impacts that noise may make in an hour of recording


@dataclass(frozen=True)
class NoiseSpectrum:
    """Power spectral density of the accelerometer's noise, one-sided.

    Attributes
    ----------
    rate_hz : float
        Sampling rate of the values that were measured.
    density_v2phz : array, shape (FRAME // 2 + 1,)
        V^2/Hz at the frequencies ``k * rate_hz / FRAME``.
    """

    rate_hz: float
    density_v2phz: Floats

    @classmethod
    def white(cls, rms_v: float, rate_hz: float) -> NoiseSpectrum:
        """Of equal density at all frequencies."""
        return cls(rate_hz, np.full(FRAME // 2 + 1, 2.0 * rms_v**2 / rate_hz))

    @property
    def frequencies_hz(self) -> Floats:
        """Frequencies of the densities."""
        return np.asarray(np.arange(self.density_v2phz.size) * (self.rate_hz / FRAME), dtype=np.float64)

    @property
    def rms_v(self) -> float:
        """Standard deviation over all frequencies from `SLOW_HZ` on, the density at `SLOW_HZ` taken below."""
        density = self.density_v2phz
        first = min(int(np.ceil(SLOW_HZ * FRAME / self.rate_hz)), density.size - 2)
        level = np.where(np.arange(density.size) < first, density[first], density)
        return float(np.sqrt((level.sum() - 0.5 * (level[0] + level[-1])) * self.rate_hz / FRAME))

    @property
    def slow_v2phz(self) -> float:
        """Density at the lowest frequencies that a frame resolves."""
        return float(np.mean(self.density_v2phz[1:4]))

    def autocovariance(self, count: int) -> Floats:
        """Autocovariance in V^2 at lags of 0 to ``count - 1`` samples, at most ``FRAME // 2`` of them."""
        trusted = np.maximum(self.density_v2phz, LEAST_PART * self.density_v2phz[1:].max())
        return np.asarray(np.fft.irfft(0.5 * trusted)[:count] * self.rate_hz)

    def whitener(self, length: int) -> Floats:
        """Lower triangle, shape (length, length), that makes ``length`` samples of noise white, of unit variance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(toeplitz(self.autocovariance(length)))))

    def innovations(self, volts: Floats) -> Floats:
        """What the `PREDICTED_FROM` samples before do not predict, in its standard deviations, shape of ``volts``."""
        r = self.autocovariance(PREDICTED_FROM + 1)
        weights = solve_toeplitz(r[:-1], r[1:])
        return np.asarray(lfilter(np.append(1.0, -weights), [1.0], volts) / np.sqrt(r[0] - weights @ r[1:]))


def measure_noise(volts: Sequence[Floats], usable: Sequence[Bools], rate_hz: float) -> NoiseSpectrum | None:
    """Spectrum of the noise from the frames in which nothing but noise is.

    Parameters
    ----------
    volts
        Pieces of the accelerometer less the plate's motion.
    usable
        Samples of each piece that count: where the motion is known, and no impact has been found.
    rate_hz
        Sampling rate.

    Returns
    -------
    NoiseSpectrum or None
        None where too few samples are usable, or the channel stands still.
    """
    rows = []
    for own, good in zip(volts, usable, strict=True):
        begins = np.arange(0, own.size - FRAME + 1, FRAME // 2)
        counts = np.concatenate([[0], np.cumsum(good)])
        whole = begins[counts[begins + FRAME] - counts[begins] == FRAME]
        rows.append(own[whole[:: len(whole) * len(volts) // MOST_FRAMES + 1, None] + np.arange(FRAME)])
    frames = np.concatenate(rows)
    if len(frames) < FEWEST_FRAMES:
        return None
    ramp, taper = np.linspace(-1.0, 1.0, FRAME), np.hanning(FRAME + 1)[:-1]
    frames -= frames.mean(axis=1, keepdims=True)
    frames -= np.outer(frames @ ramp / (ramp @ ramp), ramp)
    power = np.abs(np.fft.rfft(frames * taper)) ** 2 * (2.0 / (rate_hz * (taper @ taper)))
    density = np.quantile(power, QUIET_SHARE, axis=0) / -np.log1p(-QUIET_SHARE)
    most = 1.0 + FRAME_SIGMAS * FRAME_SCATTER / np.sqrt(power.shape[1])
    for _ in range(TURNS):
        if not density.min() > 0.0:
            return None
        quiet = np.mean(power / density, axis=1) < most
        if np.count_nonzero(quiet) < FEWEST_FRAMES:
            break
        density = power[quiet].mean(axis=0)
    density[0] = density[1]  # taken out with the mean
    return NoiseSpectrum(rate_hz, density)


def scale_and_threshold(quiet: Floats, rate_hz: float) -> tuple[float, float]:
    """Standard deviation of a detector's output where nothing happens, and its threshold in that unit.

    The tail beyond `TAIL` standard deviations is taken as exponential in the square, as a normal distribution's is,
    with the decay that the output shows. The threshold lets `FALSE_PER_HOUR` of its maxima pass in an hour.

    Parameters
    ----------
    quiet : array, shape (n,)
        Output of a filter, in the order of time.
    rate_hz : float
        Outputs a second.
    """
    deviation = np.abs(quiet)
    if deviation.size < FEWEST_FRAMES * FRAME:
        return 1.0, 0.0
    scale = float(np.sqrt(np.mean(deviation[deviation <= np.quantile(deviation[::8], CORE)] ** 2))) / CORE_SIGMA
    up = quiet[1:-1]
    tops = up[(up > TAIL * scale) & (up >= quiet[:-2]) & (up > quiet[2:])] / scale
    decay, per_hour = 1.0, max(tops.size, 1) / quiet.size * rate_hz * 3600.0
    if tops.size:
        measured = float(np.median(tops**2 - TAIL**2)) / (2.0 * np.log(2.0))
        decay = measured if measured > 1.0 + DECAY_SIGMAS * measured / np.sqrt(tops.size) else 1.0
    return scale, float(np.sqrt(TAIL**2 + 2.0 * decay * np.log(max(per_hour / FALSE_PER_HOUR, 1.0))))
