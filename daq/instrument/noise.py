"""Noise of the accelerometer away from impacts, and the traces that linear interpolation leaves in noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kernels.arrays import Floats

WINDOW_S = 12.8e-3  # of a spectrum: impacts are farther apart
FEWEST_WINDOWS = 8
PLATEAU_HZ = (150.0, 600.0)  # where the density is taken
OCTAVE = 1.1  # ratio of the ends of the band over which a spectrum is smoothed
STEEPER = 1.3  # power of the frequency that a filter's noise falls faster than; 1/f noise falls slower
LINE_PART = 0.22  # modulation of the noise by linear interpolation, relative, at least; good filters leave less
LINE_ODDS = 1e-9  # probability that chance gives so strong a line in one channel
DECLINES = 3.0  # most times the usual size that a second difference counts for: impacts and edges are no noise
WITNESSES = 2  # channels that must show the same line
SAMPLES = 1 << 13  # looked at together for lines
PICKED_UP = 20.0  # power of a line in a channel itself over what is near it


def window_samples(rate_hz: float) -> int:
    """Samples of a window of the noise's spectrum."""
    return max(1 << round(math.log2(WINDOW_S * rate_hz)), 16)


def spectrum(windows: Sequence[Floats], rate_hz: float) -> tuple[Floats, Floats] | None:
    """Frequencies and power density of noise, (n // 2 + 1,) each, from windows (n,) of it; None where they are few.

    The median over the windows, so that an impact in some of them does not count.
    """
    if len(windows) < FEWEST_WINDOWS:
        return None
    x = np.asarray(windows)
    hann = np.hanning(x.shape[1] + 2)[1:-1]
    x = (x - x.mean(axis=1, keepdims=True)) * hann
    power = np.abs(np.fft.rfft(x, axis=1)) ** 2 * (2.0 / (rate_hz * float(hann @ hann)))
    hz = np.arange(power.shape[1]) * rate_hz / x.shape[1]
    return hz, np.asarray(np.median(power, axis=0) / np.log(2.0))


def described(hz: Floats, power: Floats) -> tuple[float, float, float | None]:
    """Rms, density at low frequencies, and bandwidth (None: all of it) of noise with a power density (n,)."""
    rms = float(np.sqrt(power[1:].sum() * hz[1]))
    low = (hz >= max(PLATEAU_HZ[0], hz[2])) & (hz <= max(PLATEAU_HZ[1], hz[4]))
    plateau = float(np.median(power[low]))
    if plateau <= 0.0:
        return rms, 0.0, None
    smooth = np.array([power[(hz >= f / OCTAVE) & (hz <= f * OCTAVE)].mean() for f in hz[1:-1]])
    above = np.flatnonzero(smooth > 0.5 * plateau)
    edge = int(above[-1]) + 1 if len(above) else 0
    if edge >= len(smooth):
        return rms, plateau**0.5, None
    far = min(4 * (edge + 1) - 1, len(smooth) - 1)
    falls = smooth[far] / smooth[edge] < (hz[1:-1][far] / hz[1:-1][edge]) ** -STEEPER
    return rms, plateau**0.5, float(hz[1:-1][edge]) if falls else None


def interpolation_hz(channels: Sequence[Sequence[Floats]], rate_hz: float) -> float | None:
    """Beat of two sample rates at which the noise of several channels comes and goes; None where it does not.

    A value interpolated linearly between two others has less noise the farther it is from both, so that the noise
    varies with the beat of the two rates, in all channels alike.

    Parameters
    ----------
    channels
        Volts of stretches, (n,) each, for each channel.
    rate_hz
    """
    lines = [line for stretches in channels if (line := _line(stretches)) is not None]
    for line in lines:
        near = [other for other in lines if abs(other - line) < 3.0 / SAMPLES]
        if len(near) >= WITNESSES:
            return float(np.mean(near)) * rate_hz
    return None


def _line(stretches: Sequence[Floats]) -> float | None:
    """Strongest line in the size of the second differences, in units of the rate; None where chance explains it.

    A line in the differences themselves is a tone picked up by the cable, and no trace of interpolation.
    """
    sizes, bends = np.zeros(SAMPLES // 2 + 1), np.zeros(SAMPLES // 2 + 1)
    level, count, hann = 0.0, 0, np.hanning(SAMPLES)
    for volts in stretches:
        bend = np.diff(volts, 2)[: (len(volts) - 2) // SAMPLES * SAMPLES].reshape(-1, SAMPLES)
        size = np.abs(bend)
        usual = (float(np.median(size)) or float(size.mean())) if size.size else 0.0
        if usual > 0.0:
            limit = DECLINES * usual
            size, bend = np.minimum(size, limit) / usual, np.clip(bend, -limit, limit) / usual
            level, count = level + float(size.mean(axis=1).sum()), count + len(size)
            sizes += (np.abs(np.fft.rfft((size - size.mean(axis=1, keepdims=True)) * hann)) ** 2).sum(axis=0)
            bends += (np.abs(np.fft.rfft(bend * hann)) ** 2).sum(axis=0)
    if not count:
        return None
    first = SAMPLES // 64  # below, the motion itself comes and goes
    k = first + int(np.argmax(sizes[first:-2]))
    modulation = 4.0 * np.sqrt(sizes[k] / count) / SAMPLES / (level / count)
    ratio = float(sizes[k] / np.median(sizes[first:]))
    chance = len(sizes) * np.exp(-count * (ratio - 1.0 - np.log(ratio)))  # Chernoff's bound for a sum of exponentials
    tones = [
        float(bends[q - 1 : q + 2].max() / max(float(np.median(bends[q - 32 : q + 33])), 1e-300))
        for q in (k // 2, (SAMPLES - k) // 2)
    ]
    return None if modulation < LINE_PART or chance > LINE_ODDS or max(tones) > PICKED_UP else k / SAMPLES
