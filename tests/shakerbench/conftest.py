"""A small run of the simulated rig, made through the public package."""

from __future__ import annotations

from pathlib import Path

import pytest

import shakerbench as sb

GAMMAS = [0.6, 0.9, 1.2, 1.7]


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four steps of a rig that hides friction."""
    path = tmp_path_factory.mktemp("public") / "run.h5"
    small = {"ramp.gamma": GAMMAS, "ramp.settle_cycles": 6, "ramp.hold_cycles": 24}
    summary = sb.run(sb.load_profile("simulated").with_values(small), path, scenario="friction", seed=3)
    assert (summary.how, summary.steps_driven) == ("complete", 4)
    return path
