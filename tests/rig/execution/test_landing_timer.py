"""Landings by their ringing, to a small part of a sample."""

from __future__ import annotations

import math

import numpy as np

from rig.execution.branch_hold import LandingTimer

RATE_HZ = 20000.0
N = 240


def stretch(place: float, size: float, rng: np.random.Generator, slope: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """Ringing from ``place`` on over a moving plate, with noise; and where none is."""
    since_s = (np.arange(N) - place) / RATE_HZ
    ring = np.where(since_s > 0.0, np.exp(-since_s / 1e-3) * np.sin(2 * math.pi * 1700.0 * since_s), 0.0)
    plate = slope * np.sin(2 * math.pi * 25.0 * since_s + 0.3)
    return size * ring + plate + 0.3 * rng.standard_normal(N), since_s < 0.0


def test_landings_are_timed_to_a_microsecond_but_for_a_common_offset() -> None:
    """Forty impacts at any part of a sample: times agree with the true ones to 1 us, and the claimed sigma holds."""
    rng, timer = np.random.default_rng(1), LandingTimer(RATE_HZ)
    places = 80.0 + 10.0 * rng.random(40)
    found = [timer.find(*stretch(place, 40.0, rng)) for place in places]
    off = np.array([one.place for one in found])[8:] - places[8:]
    assert np.std(off) / RATE_HZ < 1e-6
    assert np.std(off) < 2.0 * found[-1].uncertainty


def test_what_is_no_landing_is_none() -> None:
    """After landings were seen, noise and a click of one sample are not taken for one."""
    rng, timer = np.random.default_rng(2), LandingTimer(RATE_HZ)
    for place in (80.2, 84.7, 79.9):
        assert timer.find(*stretch(place, 40.0, rng)) is not None
    nothing, quiet = stretch(80.0, 0.0, rng)
    assert timer.find(nothing, quiet) is None
    nothing[100] += 20.0
    assert timer.find(nothing, quiet) is None
