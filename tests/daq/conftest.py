"""What the tests of `daq` share: a set-up, and frames as a rig would give them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from daq.setup.setup import Setup
from kernels.arrays import Floats

RATE_HZ = 2000.0


@pytest.fixture
def setup() -> Setup:
    """A rig at 2 kHz with a drive scale of 2 g/V and an accelerometer of 0.1 V/g."""
    return Setup.model_validate(
        {
            "name": "test",
            "sampling": {"rate_hz": RATE_HZ},
            "forcing": {"frequency_hz": 25.37},
            "drive": {"g_per_volt": {"value": 2.0, "uncertainty": 0.01}},
            "channels": {"accelerometer": {"sensitivity": {"value": 0.1, "uncertainty": 0.0005}, "unit": "V/g"}},
            "ball": {"mass_kg": 0.25},
        }
    )


@pytest.fixture
def ramp() -> Callable[..., Floats]:
    """``ramp(levels, frequencies)``: volts of a drive that holds each level for 20 cycles after a fade of 2."""

    def make(
        levels: list[float], frequencies_hz: list[float], rate_hz: float = RATE_HZ, ratio: int = 1, fade: int = 2
    ) -> Floats:
        pieces, phase, before = [np.zeros(round(0.2 * rate_hz))], 0.0, 0.0
        for level, frequency in zip(levels, frequencies_hz, strict=True):
            n_fade, n_hold = round(fade * rate_hz / frequency), round(20 * rate_hz / frequency)
            smooth = 0.5 - 0.5 * np.cos(np.pi * np.arange(n_fade) / max(n_fade, 1))
            envelope = np.concatenate([before + (level - before) * smooth, np.full(n_hold, level)])
            angle = phase + 2 * np.pi * frequency / rate_hz * np.arange(n_fade + n_hold)
            wave = np.sin(angle) + (ratio**2 * np.sin(ratio * angle) if ratio > 1 else 0.0)
            pieces.append(envelope * wave)
            phase, before = angle[-1] + 2 * np.pi * frequency / rate_hz, level
        return np.concatenate([*pieces, np.zeros(round(0.2 * rate_hz))])

    return make
