"""The mode of a table from one tap."""

from __future__ import annotations

import numpy as np
import pytest

from rig.checks.check import mode_of_tap

RATE_HZ = 20_000.0


def _tapped(hz: float, damping: float) -> np.ndarray:
    """Seven seconds of noise about a zero, with a hammer's pulse, ringing of its mount, and the mode, after two."""
    time_s = np.arange(round(7.0 * RATE_HZ)) / RATE_HZ - 2.0
    since_s, w = np.maximum(time_s, 0.0), 2.0 * np.pi * hz
    mode = np.exp(-damping * w * since_s) * np.sin(w * np.sqrt(1.0 - damping**2) * since_s)
    mount = 20.0 * np.exp(-since_s / 2e-3) * np.sin(2.0 * np.pi * 900.0 * since_s)
    noise = 0.05 * np.random.default_rng(7).standard_normal(len(time_s))
    return 9.8 + noise + np.where(time_s > 0.0, mode + mount, 0.0)


@pytest.mark.parametrize(("hz", "damping"), [(2.5, 0.02), (7.5, 0.04), (11.0, 0.2), (60.0, 0.01)])
def test_frequency_and_damping_come_out_of_one_tap(hz: float, damping: float) -> None:
    """To one and to five hundredths, behind a mount that rings louder, with an offset and noise."""
    found = mode_of_tap(_tapped(hz, damping), RATE_HZ)
    assert found is not None
    assert found[0] == pytest.approx(hz, rel=0.01) and found[1] == pytest.approx(damping, rel=0.05)


def test_a_table_that_is_not_hit_has_no_mode() -> None:
    """Noise, a pulse after which nothing rings, and an input that stands still or is cut off by its hit, are none."""
    noise = np.random.default_rng(8).standard_normal(round(5.0 * RATE_HZ))
    assert mode_of_tap(noise, RATE_HZ) is None
    noise[30_000] = 200.0
    assert mode_of_tap(noise, RATE_HZ) is None
    still = np.full(len(noise), 2.5)
    assert mode_of_tap(still, RATE_HZ) is None
    still[30_000] = 5.0
    assert mode_of_tap(still, RATE_HZ) is None
