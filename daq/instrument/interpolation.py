"""Traces that linear interpolation leaves in the noise of channels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kernels.arrays import Floats

SAMPLES = 1 << 13  # looked at together for lines


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
        # one channel may hum: two must show the same line
        if len(near) >= 2:
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
            # impacts and edges are no noise: a second difference counts for three times the usual size at most
            limit = 3.0 * usual
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
    # good filters modulate by less than 0.22; a line of the motion itself stands in the differences as well
    return None if modulation < 0.22 or chance > 1e-9 or max(tones) > 20.0 else k / SAMPLES
