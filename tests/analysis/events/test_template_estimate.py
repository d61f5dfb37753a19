"""A template estimated from the accelerometer: the threshold of its detector, from its own output."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.template_estimate import FALSE_PER_HOUR, scale_and_threshold

RATE_HZ = 20000.0


def test_a_threshold_comes_from_the_output_of_the_detector() -> None:
    """Normal output: six sigmas, whatever its size. A heavier tail: higher, and passed no more often than stated."""
    rng = np.random.default_rng(2)
    scale, threshold = scale_and_threshold(1.7 * rng.standard_normal(400_000), RATE_HZ)
    assert scale == pytest.approx(1.7, rel=0.01)
    assert threshold == pytest.approx(6.2, abs=0.3)

    def bursts(n: int) -> np.ndarray:
        return rng.standard_normal(n) * np.where(rng.random(n) < 0.1, 2.0, 1.0)

    scale, threshold = scale_and_threshold(bursts(400_000), RATE_HZ)
    assert threshold > 7.0
    hours = 20_000_000 / RATE_HZ / 3600.0
    assert np.count_nonzero(bursts(20_000_000) > threshold * scale) <= 3 + hours * FALSE_PER_HOUR
