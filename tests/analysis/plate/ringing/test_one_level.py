"""The level that all tones of a recorded drive have in common."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.plate.ringing.one_level import OneLevel
from kernels.arrays import Floats

BLOCK_S, HZ = 1e-3, 25.37


def _fade(time_s: Floats) -> Floats:
    x = np.clip((time_s - 1.0) / 0.08, 0.0, 1.0)
    return np.asarray(1.0 - 0.4 * x**3 * (10.0 + x * (6.0 * x - 15.0)))


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("off", [0.0, 2e-4])
def test_a_fade_of_two_cycles_is_the_same_for_all_tones(order: int, off: float) -> None:
    """Whether displacement, speed or acceleration is recorded, with a frequency that is not quite as stated."""
    w = 2.0 * np.pi * HZ * (1.0 + off)
    fine_s = (np.arange(-20, 200020) + 0.5) * BLOCK_S / 100.0
    asked = _fade(fine_s) * (np.sin(w * fine_s) + np.sin(2.0 * w * fine_s + 1.0))
    for _ in range(order):
        asked = np.gradient(asked, w * fine_s[1] - w * fine_s[0])
    noise = 1e-4 * np.random.default_rng(1).standard_normal(2000)
    drive = asked[20:-20].reshape(2000, 100).mean(axis=1) + noise
    found = OneLevel.of(drive, BLOCK_S, HZ, (1, 2), np.array([[0, 1000], [1100, 2000]]))
    time_s = (np.arange(2000) + 0.5) * BLOCK_S
    level = found.level[:, :2000] / found.level[0, 0]
    assert np.std(found.left) * np.std(drive) < 4e-4
    np.testing.assert_allclose(level[0], _fade(time_s), atol=2e-3)
    np.testing.assert_allclose(level[1], np.gradient(_fade(time_s), w * BLOCK_S), atol=5e-3)
    np.testing.assert_allclose(level[1:, :1000], 0.0, atol=1e-12)


def test_a_drive_that_stands_still_has_no_tones() -> None:
    """Nothing is recorded of it: all is zero, and finite."""
    found = OneLevel.of(np.zeros(500), BLOCK_S, HZ, (1,), np.array([[0, 250], [260, 500]]))
    assert (found.recorded == 0.0).all() and np.isfinite(found.level).all()
