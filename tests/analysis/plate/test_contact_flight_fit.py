"""Separate amplitudes in contact and in flight."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.plate.motion import ContactFlightFit
from daq.lock_in import LockIn

RATE_HZ, TONES_HZ, NOISE = 1000.0, np.array([25.0, 50.0, 75.0]), 0.5
AMPLITUDES, OFFSET, EXTRA = np.array([10.0 * np.exp(0.7j), 0.2, 0.1j]), 9.8, 0.05 * 10.0 * np.exp(0.7j)


def fit_of(seed: int, part: float) -> ContactFlightFit:
    """A plate that moves 5 % more in contact, which lasts for ``part`` of each cycle."""
    n = np.arange(640)
    contact = np.mod(n * 25.0 / RATE_HZ + 0.3, 1.0) < part
    turns = np.exp(2j * np.pi * TONES_HZ[:, None] * n / RATE_HZ)
    x = OFFSET + (AMPLITUDES @ turns).real + np.where(contact, (EXTRA * turns[0]).real, 0.0)
    x += NOISE * np.random.default_rng(seed).standard_normal(n.size)
    total, own = LockIn(RATE_HZ, TONES_HZ), LockIn(RATE_HZ, TONES_HZ)
    total.add(x, 0)
    own.add(x, 0, contact)
    return ContactFlightFit(own, total, (0,), NOISE)


@pytest.mark.parametrize("part", [0.2, 0.4, 0.7])
def test_the_change_of_the_amplitude_is_as_uncertain_as_it_says(part: float) -> None:
    """Contact that comes at one phase of every cycle tells a tone's quadratures unequally well."""
    found = [fit_of(seed, part).log_gain() for seed in range(400)]
    assert None not in found
    changes, stated = np.array(found, dtype=np.float64).T
    assert np.std(changes) == pytest.approx(np.median(stated), rel=0.15)  # four standard errors
    assert np.mean(changes) == pytest.approx(-np.log(1.05), abs=4.0 * np.median(stated) / np.sqrt(400))


def test_too_little_contact_tells_nothing() -> None:
    """Fewer blocks than the fit needs give no result rather than a wild one."""
    assert fit_of(0, 0.05).log_gain() is None
