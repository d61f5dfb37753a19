"""Gamma at the plate over a step's hold."""

from __future__ import annotations

import numpy as np
import pytest

from bench.profiles.find import load
from daq.importers.plausibility import achieved_gamma
from daq.steps.find_steps import find_steps
from daq.steps.forcing_detection import Signal
from rig.profile import parse_profile

RATE_HZ, HZ, GAMMA = 20_000.0, 25.37, 1.4


@pytest.mark.parametrize("decay_s", [0.001, 0.007])
def test_a_table_that_rings_through_the_cycle_does_not_bend_gamma(decay_s: float) -> None:
    """Impacts of up to 3 g ring at 780 Hz in every cycle, while the ball rests for a third of it."""
    setup = parse_profile(load("simulated")[1]).setup()
    rng, time_s = np.random.default_rng(3), np.arange(round(40 / HZ * RATE_HZ)) / RATE_HZ
    drive = -2.0 * GAMMA * np.sin(2.0 * np.pi * HZ * time_s)  # g; both tones at c = 1
    since_s = np.mod(time_s - 0.011, 1.0 / HZ)
    ringing = 3.0 * np.exp(-since_s / decay_s) * np.cos(2.0 * np.pi * 780.0 * since_s)
    volts = {
        "drive": drive / 2.0 + 1e-4 * rng.standard_normal(time_s.size),
        "accelerometer": 0.1 * (drive + ringing) + 3e-4 * rng.standard_normal(time_s.size),
        "continuity": np.where(since_s < 0.3 / HZ, 0.0, 5.0) + 1e-3 * rng.standard_normal(time_s.size),
    }
    read = {name: lambda a, b, x=x: x[a:b] for name, x in volts.items()}
    (step,) = find_steps(Signal(read["drive"], RATE_HZ, setup.forcing), 0, time_s.size)
    gamma, sigma = achieved_gamma(read, step, RATE_HZ, setup)
    assert gamma == pytest.approx(GAMMA, rel=2e-3)
    assert sigma < 0.01 * gamma
