"""What a channel can show: its noise spectrum, and its ends, at which readings stand.

Noise of a channel as a spectrum, measured where nothing happens: the one measure of noise, of import and analysis.
A sensor, its amplifier and its converter colour the noise: a low-pass takes its upper part, semiconductors add 1/f.
What detects impacts must know the noise at the frequencies of an impact. Decisions 295 and 433.

A reading that stands at its largest or smallest value: sensor or converter are at their end.
The tones of motion that is cut off are too small, and no fit can tell. Impacts that are cut off do no harm to a tone,
but they are not the waveform that other impacts have. Decision 310.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz, toeplitz
from scipy.signal import lfilter

from kernels import njit
from kernels.arrays import Bools, Floats, Integers

FRAME = 128  # samples of a periodogram
FEWEST_FRAMES = 8  # periodograms from which a spectrum is measured
QUIET_SHARE = 0.25  # quantile of the periodograms that the first estimate takes: most may hold an impact
PLATEAU_HZ = (150.0, 600.0)  # where the density at low frequencies is taken
OCTAVE = 1.1  # ratio of the ends of the band over which a spectrum is smoothed where its bandwidth is sought
PREDICTED_FROM = 16  # samples from which the next one is predicted


@dataclass(frozen=True)
class NoiseSpectrum:
    """Power spectral density of a channel's noise, one-sided."""

    rate_hz: float  # sampling rate of the values that were measured
    # V^2/Hz at the frequencies ``k * rate_hz / frame``, of frames of `FRAME` samples where nothing else is
    # asked for
    density_v2phz: Floats

    @classmethod
    def white(cls, rms_v: float, rate_hz: float) -> NoiseSpectrum:
        """Of equal density at all frequencies."""
        return cls(rate_hz, np.full(FRAME // 2 + 1, 2.0 * rms_v**2 / rate_hz))

    @property
    def frequencies_hz(self) -> Floats:
        """Frequencies of the densities."""
        return np.linspace(0.0, 0.5 * self.rate_hz, self.density_v2phz.size)

    @property
    def rms_v(self) -> float:
        """Standard deviation over all frequencies from 500 Hz on, the density there taken below."""
        density, step_hz = self.density_v2phz, float(self.frequencies_hz[1])
        # below, a recording holds the motion of the plate as well
        first = min(int(np.ceil(500.0 / step_hz)), density.size - 2)
        level = np.where(np.arange(density.size) < first, density[first], density)
        return float(np.sqrt((level.sum() - 0.5 * (level[0] + level[-1])) * step_hz))

    @property
    def slow_v2phz(self) -> float:
        """Density at the lowest frequencies that a frame resolves well."""
        hz = self.frequencies_hz
        low = (hz >= max(min(PLATEAU_HZ[0], 0.5 * hz[-1]), hz[1])) & (hz <= max(PLATEAU_HZ[1], hz[3]))
        return float(np.mean(self.density_v2phz[low]))

    @property
    def bandwidth_hz(self) -> float | None:
        """Frequency at which the density has fallen by half for good; None where it is flat, or falls as 1/f does."""
        hz, power = self.frequencies_hz, self.density_v2phz
        smooth = np.array([power[(hz >= f / OCTAVE) & (hz <= f * OCTAVE)].mean() for f in hz[1:-1]])
        above = np.flatnonzero(smooth > 0.5 * self.slow_v2phz)
        edge = int(above[-1]) + 1 if len(above) else 0
        if edge >= len(smooth):
            return None
        far = min(4 * (edge + 1) - 1, len(smooth) - 1)
        # a filter's noise falls faster than with the power 1.3 of the frequency, 1/f noise slower
        falls = smooth[far] / smooth[edge] < (hz[1:-1][far] / hz[1:-1][edge]) ** -1.3
        return float(hz[1:-1][edge]) if falls else None

    def autocovariance(self, count: int) -> Floats:
        """Autocovariance in V^2 at lags of 0 to ``count - 1`` samples, at most ``FRAME // 2`` of them."""
        # where the density is below a hundredth of the largest no waveform is known well enough to count on
        trusted = np.maximum(self.density_v2phz, 0.01 * self.density_v2phz[1:].max())
        return np.asarray(np.fft.irfft(0.5 * trusted)[:count] * self.rate_hz)

    def whitener(self, length: int) -> Floats:
        """Lower triangle, shape (length, length), that makes ``length`` samples of noise white, of unit variance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(toeplitz(self.autocovariance(length)))))

    def innovations(self, volts: Floats) -> Floats:
        """What the `PREDICTED_FROM` samples before do not predict, in its standard deviations, shape of ``volts``."""
        r = self.autocovariance(PREDICTED_FROM + 1)
        weights = solve_toeplitz(r[:-1], r[1:])
        return np.asarray(lfilter(np.append(1.0, -weights), [1.0], volts) / np.sqrt(r[0] - weights @ r[1:]))


def measure_noise(
    volts: Sequence[Floats], usable: Sequence[Bools], rate_hz: float, frame: int = FRAME
) -> NoiseSpectrum | None:
    """Spectrum of the noise from the frames in which nothing but noise is.

    ``volts`` are pieces of a channel less what it shows (of the accelerometer less the plate's motion), ``usable`` the
    samples of each that count: where the motion is known, and no impact has been found. A longer ``frame`` shows lower
    frequencies. None where too few samples are usable, or the channel stands still.
    """
    rows = []
    for own, good in zip(volts, usable, strict=True):
        begins = np.arange(0, own.size - frame + 1, frame // 2)
        counts = np.concatenate([[0], np.cumsum(good)])
        whole = begins[counts[begins + frame] - counts[begins] == frame]
        # of a long recording some 1024 frames, evenly
        rows.append(own[whole[:: len(whole) * len(volts) // 1024 + 1, None] + np.arange(frame)])
    frames = np.concatenate([np.zeros((0, frame)), *rows])
    if len(frames) < FEWEST_FRAMES:
        return None
    ramp, taper = np.linspace(-1.0, 1.0, frame), np.hanning(frame + 1)[:-1]
    frames -= frames.mean(axis=1, keepdims=True)
    frames -= np.outer(frames @ ramp / (ramp @ ramp), ramp)
    power = np.abs(np.fft.rfft(frames * taper)) ** 2 * (2.0 / (rate_hz * (taper @ taper)))
    density = np.quantile(power, QUIET_SHARE, axis=0) / -np.log1p(-QUIET_SHARE)
    # left out is a frame whose mean power is four standard deviations too high: the taper correlates neighbouring
    # frequencies, so that one is 1.3 over the root of their number
    most = 1.0 + 4.0 * 1.3 / np.sqrt(power.shape[1])
    # the density decides which frames are quiet, and they give the density: four turns settle it
    for _ in range(4):
        if not density.min() > 0.0:
            return None
        quiet = np.mean(power / density, axis=1) < most
        if np.count_nonzero(quiet) < FEWEST_FRAMES:
            break
        density = power[quiet].mean(axis=0)
    density[0] = density[1]  # taken out with the mean
    return NoiseSpectrum(rate_hz, density)


STANDS = 0.02  # share of the samples at an end from which it saturates: a sine cut off there has lost 0.2 % of its peak
STANDS_S = 1e-3  # time at an end from which it is the motion that stands there: a table's ringing turns sooner
CROWDED = 3.0  # times as many in the outermost band as in the next one; where a sine turns there are 2.4 times as many

Ends = tuple[float, float]
NO_ENDS: Ends = (-math.inf, math.inf)


def ends_of(values: npt.NDArray[Any]) -> Ends:
    """Reading at or below which, and the one at or above which, the sensor is at its end; infinite where it is not.

    Noise behind the sensor spreads its end over a band: the outermost part of the readings' (n,) range is compared with
    the next one, for parts of several sizes.
    """
    # whole codes are sorted several times faster than numbers; noise may spread an end over so many parts of the range
    parts = np.array([200.0, 100.0, 50.0, 25.0])
    low, high = float(values.min()), float(values.max())
    least, counts = _outermost(values, low, high, np.sort(values[:4096]), parts)
    widths = np.maximum((high - low) / parts, least)
    # the half of a step below an end is the end too, whatever rounding the reading has gone through
    below, above = (
        _end(values, sign, top, widths, counts[side], 0.5 * least)
        for side, (sign, top) in enumerate(((-1.0, -low), (1.0, high)))
    )
    return 0.25 * least - below, above - 0.25 * least


@njit(error_model="numpy")
def _outermost(values, low, high, in_order, parts):  # type: ignore[no-untyped-def]
    """Twice the least step between values in order, and how many of all lie at the lower and at the upper end.

    These are (2, k, 2): within one of ``parts`` (k,) of the range, twice the step at least, and within two of them.
    """
    least = np.inf
    for i in range(1, in_order.shape[0]):
        step = np.float64(in_order[i]) - np.float64(in_order[i - 1])
        least = step if 0.0 < step < least else least
    least = 2.0 * least if least < np.inf else 0.0
    counts = np.zeros((2, parts.shape[0], 2), dtype=np.int64)
    widths = np.maximum((high - low) / parts, least)
    bottom, top = low + 2.0 * widths[-1], high - 2.0 * widths[-1]
    for x in values:
        if x < bottom or x > top:  # few are
            for k in range(parts.shape[0]):
                for twice in range(2):
                    counts[0, k, twice] += x < low + (1 + twice) * widths[k]
                    counts[1, k, twice] += x > high - (1 + twice) * widths[k]
    return least, counts


def _end(values: npt.NDArray[Any], sign: float, top: float, widths: Floats, counts: Integers, step: float) -> float:
    """Reading times ``sign`` from which on an end is reached; the largest is ``top``, and codes differ by ``step``."""
    for width, (at, both) in zip(widths.tolist(), counts.tolist(), strict=True):
        # four sigma of the counts: the readings crowd at an end
        if at - CROWDED * (both - at) > 4.0 * math.sqrt(at + CROWDED**2 * (both - at)):
            near = sign * values.astype(np.float64)
            near = near[near > top - width]
            level = float(np.median(near))
            # readings within four standard deviations of the noise about an end are at the end
            end = level - 4.0 * math.sqrt(0.5 * math.pi) * float(np.mean(near[near >= level] - level))
            # a level between two codes is read as either: so is the next code where readings hop to it and back
            here, hopping = (_stay(sign * values >= end - part * step) for part in (0.5, 1.5))
            return end - step if hopping > 2.0 * here else end
    return math.inf


def common_ends(stretches: Sequence[npt.NDArray[Any]], rate_hz: float, zero: float = math.nan) -> Ends:
    """Ends that some stretches of a sensor's readings, (n,) each, show, and beyond which no other one reads.

    Each stretch holds one motion: together, where weaker ones turn, there are as many readings as at an end. Impacts
    that are all alike have their peaks in as narrow a band, but do not stay there. Both ends are as far from ``zero``,
    the reading of no acceleration, where that is known: motion that is cut off at one and hardly reaches the other
    shows no crowd there.
    """
    if not stretches:
        return NO_ENDS
    pairs, ends = [ends_of(x) for x in stretches], []
    for side, sign in enumerate((-1.0, 1.0)):
        tops = [float(np.max(sign * x)) for x in stretches]
        found = [sign * pair[side] for pair in pairs]
        held = [
            end for end, top, x in zip(found, tops, stretches, strict=True)
            # a reading far beyond, in another stretch, shows that this was a turning point of the motion, no end
            if max(tops) <= top + 0.5 * (top - end) and _stay(sign * x >= end) > max(1e-4 * rate_hz, 2.0)
        ]  # fmt: skip
        ends.append(sign * min(held, default=math.inf))
    reach, away = (
        (zero - min(x.min() for x in stretches), max(x.max() for x in stretches) - zero),
        (zero - ends[0], ends[1] - zero),
    )
    for side, other in ((0, 1), (1, 0)):
        # as far beyond as noise reaches there
        if math.isinf(away[side]) and away[other] <= reach[side] <= 2.0 * reach[other] - away[other]:
            ends[side] = 2.0 * zero - ends[other]
    return ends[0], ends[1]


def ends_in_noise(stretches: Sequence[npt.NDArray[Any]], ends: Ends, rate_hz: float, tones_hz: Sequence[float]) -> Ends:
    """The ``ends`` of a sensor, and those that noise hides in the motion of the stretch (n,) that moves most.

    Motion of the tones that is cut off reads the same however far beyond the end it goes. Nothing reads farther, no
    impact either. Decision 726.
    """
    if not stretches or not np.isinf(ends).any():
        return ends
    values = max(stretches, key=lambda x: float(np.std(x[::16]))).astype(np.float64)
    middle, found = float(np.median(values)), list(ends)
    beyond = middle - min(float(x.min()) for x in stretches), max(float(x.max()) for x in stretches) - middle
    # most recordings show impacts that are farther out than any motion
    if min(beyond) > 1.2 * float(np.quantile(np.abs(values[::16] - middle), 0.98)):
        return ends
    turns = 2.0 * np.pi / rate_hz * np.outer(np.arange(values.size), tones_hz)
    columns = np.column_stack([np.ones(values.size), np.cos(turns), np.sin(turns)])
    clear, noise = np.ones(values.size, dtype=np.bool_), 0.0
    for _ in range(3):  # impacts are no motion
        own = columns[clear]
        weights = np.linalg.lstsq(own.T @ own, own.T @ values[clear])[0]
        left = values - columns @ weights
        noise = 1.4826 * float(np.median(np.abs(left[clear])))
        clear = np.abs(left) < 5.0 * noise
    motion = columns[:, 1:] @ weights[1:]
    for side, sign in enumerate((-1.0, 1.0)):
        # where a sine turns: a hundredth of its height takes a twentieth of its time
        near = clear & (sign * motion > 0.99 * float(np.max(sign * motion)))
        away = sign * (motion[near] - np.mean(motion[near]))
        spread = float(np.sqrt(away @ away))
        if not spread > 6.0 * noise:
            continue
        level, slope = float(np.mean(sign * values[near])), float(away @ (sign * values[near])) / spread**2
        # six standard deviations below the slope of motion, and far below what a harmonic makes of it
        flat = slope + 6.0 * noise / spread < 1.0 and slope < 0.3
        here = float(np.std(values[near]))  # what is flat scatters by noise
        # a filter behind the sensor overshoots where an impact is cut off, by a tenth at most
        if flat and math.isinf(ends[side]) and beyond[side] < 1.1 * (level - sign * middle) + 6.0 * here:
            found[side] = sign * (level - 4.0 * here)
    return found[0], found[1]


def _stay(at_end: Bools) -> float:
    """Mean length of the unbroken runs of readings at an end."""
    runs = int(np.count_nonzero(at_end[1:] & ~at_end[:-1]))
    return np.count_nonzero(at_end) / max(runs, 1)


def share_at_an_end(values: npt.NDArray[Any], rate_hz: float, ends: Ends | None = None) -> float:
    """Share of ``values`` (n,) in stretches of `STANDS_S` or more at an end: of the motion, not only of impacts.

    ``ends`` are those of the same sensor in readings that go farther; None: of these values.
    """
    low, high = ends_of(values) if ends is None else ends
    if math.isinf(low) and math.isinf(high):
        return 0.0
    return float(_standing(values, low, high, max(int(STANDS_S * rate_hz), 1))) / len(values)


def drive_is_cut_off(values: npt.NDArray[Any], rate_hz: float) -> bool:
    """Whether a drive's reading stands at its end; below 8 kHz, where a sine's peaks crowd alike, none is said to."""
    return rate_hz >= 8e3 and share_at_an_end(values, rate_hz) > STANDS


def blocks_at_an_end(values: npt.NDArray[Any], width: int, skip: int, ends: Ends) -> Bools:
    """Which blocks of ``width`` values after the first ``skip`` hold one at an end, or are next to one that does."""
    out = np.zeros(max(len(values) - skip, 0) // width, dtype=np.bool_)
    _reach(values, width, skip, *ends, out)
    return out


@njit()
def _reach(values, width, skip, low, high, out):  # type: ignore[no-untyped-def]
    """Mark each block that holds a value at or below ``low``, or at or above ``high``, and its neighbours."""
    for i in range(skip, skip + out.shape[0] * width):
        if values[i] <= low or values[i] >= high:
            block = (i - skip) // width
            out[max(block - 1, 0) : block + 2] = True


@njit()
def _standing(values, low, high, least):  # type: ignore[no-untyped-def]
    """Values in unbroken stretches of ``least`` or more at or below ``low``, or at or above ``high``."""
    total = length = side = 0
    for i in range(values.shape[0] + 1):
        now = 0 if i == values.shape[0] else int(values[i] >= high) - int(values[i] <= low)
        if now != side:
            total += length if side != 0 and length >= least else 0
            side, length = now, 0
        length += 1
    return total
