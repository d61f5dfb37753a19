"""What the tests of import share: the columns of a foreign table."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kernels.arrays import Floats

RATE_HZ = 2000.0
LEVELS = [0.2, 0.5, 0.3]
Columns = dict[str, Floats]


@pytest.fixture
def columns(ramp: Callable[..., Floats]) -> Columns:
    """Three steps of drive, the acceleration that goes with it (2 g/V at 0.1 V/g), and a contact circuit."""
    drive = ramp(LEVELS, [25.37] * 3)
    time = np.arange(len(drive)) / RATE_HZ
    rng = np.random.default_rng(5)
    return {
        "time_s": time,
        "continuity_v": np.where((time * 25.37) % 1 < 0.4, 5.0, 0.0) + rng.normal(0, 0.01, len(time)),
        "accelerometer_v": 0.2 * drive + rng.normal(0, 1e-3, len(time)),
        "drive_v": drive,
    }
