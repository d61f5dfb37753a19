"""An accelerometer that is late: what a filter of many poles or a converter's delay is at the forcing's tones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, firwin, freqs, freqz, group_delay

from model.effects.accelerometer_lag import accelerometer_response

RATE_HZ = 20000.0
TONES_RADPS = 2.0 * np.pi * np.array([22.3, 25.4, 76.1, 120.0])


@pytest.mark.parametrize("poles", [1, 2, 4])
@pytest.mark.parametrize("corner_hz", [3000.0, 5000.0, 8000.0])
def test_a_filter_of_high_corner_is_a_delay(poles: int, corner_hz: float) -> None:
    """At the forcing's tones the loss is below 1e-3 and the phase that of one delay within a microsecond."""
    b, a = butter(poles, 2.0 * np.pi * corner_hz, analog=True)
    _, response = freqs(b, a, TONES_RADPS)
    delay_s = -float(np.angle(response[0]) / TONES_RADPS[0])
    late = accelerometer_response({"delay_s": delay_s, "low_pass_s": 0.0, "sharpness": 0.0}, TONES_RADPS)
    assert np.abs(np.abs(response) - 1.0).max() < 1e-3
    assert np.abs(np.angle(response / late) / TONES_RADPS).max() < 1e-6


def test_a_converter_of_linear_phase_is_a_delay() -> None:
    """Half a millisecond of a sigma-delta converter, within its pass band: that delay at every tone."""
    taps = firwin(21, 0.9)
    _, response = freqz(taps, worN=TONES_RADPS / RATE_HZ)
    _, samples = group_delay((taps, [1.0]), w=TONES_RADPS / RATE_HZ)
    delay_s = float(samples.mean()) / RATE_HZ
    late = accelerometer_response({"delay_s": delay_s, "low_pass_s": 0.0, "sharpness": 0.0}, TONES_RADPS)
    assert delay_s == pytest.approx(5e-4)
    assert np.abs(np.angle(response / late) / TONES_RADPS).max() < 1e-9
