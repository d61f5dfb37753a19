"""The flights of a graphics processor, in numba's simulator, are those of the processor."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from kernels.device import NoDevice, require_device

IN_THE_SIMULATOR = """
import numpy as np
from model.flight import first_landing
from model.flight.friction import edge_tables, land_with_friction
from model.flight.records import FrictionRestitution
from model.surveys import cuda_batch, cycle_batch
from model.tones import Forcing

rng = np.random.default_rng(4)
flagged = compared = 0
for c in (1, 2, 3):
    forcing, m = Forcing.superposition(c), 16
    turning = first_landing.turning_points(forcing)
    gammas = rng.uniform(1.2, 5.0, m)
    mu = rng.uniform(0.0, 0.3, m)
    laws = np.column_stack([mu, mu, np.zeros(m), np.zeros(m)])
    starts = np.column_stack([np.zeros(m), np.zeros(m), np.zeros(m)])  # from rest at the first threshold
    starts[m // 2 :, 1] = rng.uniform(0.01, 3.0, m - m // 2)  # launched with a speed
    starts[m // 2 :, 2] = -1.0
    tables = [edge_tables(forcing.tones, turning, g, FrictionRestitution(*law)) for g, law in zip(gammas, laws)]
    starts[:, 0] = [t.up[0] + 0.3 for t in tables]
    device = cuda_batch.landings(forcing, gammas, laws, starts)
    for row in range(m):
        rests = starts[row, 2] >= 0.0
        phi0 = tables[row].up[0] if rests else starts[row, 0]
        law = FrictionRestitution(*laws[row])
        here = land_with_friction(forcing.tones, gammas[row], tables[row], law, phi0, starts[row, 1], bool(rests))
        if here[3] or device[row, 3]:
            flagged += 1
            continue
        scale = 1.0 + np.abs(here[:3])
        assert np.all(np.abs(device[row, :3] - here[:3]) < 1e-12 * scale), (c, row, device[row], here)
        compared += 1
    gammas, laws = np.array([0.1, 0.7, 1.2]), np.array([[0.1, 0.1, 0.0, 0.0]] * 3)
    outcome, kept = cuda_batch.cycles(forcing, gammas, laws, 8)
    there, taus = np.empty_like(outcome), np.empty_like(kept)
    cycle_batch.friction_batch(forcing.tones, turning, gammas, laws, True, 256, there, taus)
    assert np.array_equal(outcome[:, :4], there[:, :4]), (outcome, there)
    assert np.allclose(kept, taus, rtol=1e-10, atol=1e-10, equal_nan=True)
print(compared, flagged)
"""


@pytest.mark.slow
def test_flights_of_the_device_equal_those_of_the_processor() -> None:
    """Time, phase and impact speed agree to 1e-12 on every flight that neither flags, and so do whole cycles."""
    env = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1", "PYTHONWARNINGS": "ignore"}
    done = subprocess.run(
        [sys.executable, "-c", IN_THE_SIMULATOR], env=env, capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stderr
    compared, flagged = map(int, done.stdout.split())
    assert compared >= 24 and compared + flagged == 48


def test_without_a_device_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where numba finds no graphics processor, the error names the option and the way on."""
    from numba import cuda

    monkeypatch.setattr(cuda, "is_available", lambda: False)
    with pytest.raises(NoDevice, match=r"--device cuda: no NVIDIA GPU .* leave --device out"):
        require_device()
