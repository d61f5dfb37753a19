"""Traces of linear interpolation in the noise of channels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import resample_poly

from daq.instrument.measure import interpolation_hz

RATE_HZ = 20000.0


@pytest.mark.parametrize(
    ("rate_hz", "lines", "beat_hz"),
    [(44100, True, 20000), (18000, True, 2000), (48000, True, 20000), (48000, False, None), (20000, False, None)],
)
def test_linear_interpolation_shows_in_the_noise(rate_hz: int, lines: bool, beat_hz: float | None) -> None:
    """Files brought to another rate by straight lines are known by the beat of the rates; by a good filter, or not
    brought to another rate at all, they are not."""
    rng, channels = np.random.default_rng(4), []
    t = np.arange(60_000) / RATE_HZ
    motion = np.sin(2 * np.pi * 25.37 * t)
    for _ in range(2):
        x = motion + rng.normal(0.0, 0.01, len(t))
        if lines:
            x = np.interp(np.arange(0.0, t[-1], 1.0 / rate_hz), t, x)
        elif rate_hz != RATE_HZ:
            x = resample_poly(x, 12, 5, window=("kaiser", 14.0))[200:-200]
        channels.append([x])
    found = interpolation_hz(channels, float(rate_hz))
    assert (found is None) == (beat_hz is None)
    assert found is None or found == pytest.approx(beat_hz, abs=8.0)
    assert interpolation_hz(channels[:1], float(rate_hz)) is None  # one witness is none
