"""An accelerometer that feels a sideways mode of the table."""

import numpy as np
import pytest
from scipy.signal import bilinear, freqz

from model.effects.accelerometer_cross_axis import accelerometer_response


@pytest.mark.parametrize("share", [-0.05, 0.05])
def test_the_reading_is_that_of_the_simulated_sensor(share: float) -> None:
    """5 % of a mode of 90 Hz that is three times as large as what drives it: the same gain and phase at each tone."""
    tones_hz, w = np.array([22.3, 50.0, 76.1]), 2.0 * np.pi * 90.0
    b, a = bilinear([share * 3.0 * 0.1 * w, 0.0], [1.0, 0.1 * w, w * w], fs=160e3)
    _, sideways = freqz(b, a, worN=2.0 * np.pi * tones_hz / 160e3)
    found = accelerometer_response({"lead_s": share * 0.3 / w, "frequency_hz": 90.0}, 2.0 * np.pi * tones_hz)
    assert np.abs(found / (1.0 + sideways) - 1.0).max() < 1e-5
