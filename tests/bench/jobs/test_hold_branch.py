"""The branch that a profile's ramp is held on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.jobs.run_ramp import locked_branch
from bench.profiles.find import load
from daq.setup.errors import InputError
from rig.profile import parse_profile


def test_the_branch_of_a_profile_is_that_of_its_forcing_and_its_declared_effects() -> None:
    """The shipped profile's is the ideal ball's, by the drive's own phase; a declared friction moves it."""
    profile, text = load("simulated")
    branch = locked_branch(profile)
    peak = 2.0 * branch.gamma
    np.testing.assert_allclose(branch.phase[:, 0], np.arccos(math.pi / peak), rtol=0, atol=1e-12)
    late = locked_branch(parse_profile(text.replace("[0.0, 0.0] # p1", "[-30.0, -30.0] # p1")))
    np.testing.assert_allclose(late.phase[-1], branch.phase[-1] + math.radians(30.0), rtol=0, atol=1e-12)
    rough = locked_branch(parse_profile(text + "\n[declared.coulomb_friction]\nmu_up = 0.1\nmu_down = 0.1\n"))
    assert rough.gamma[0] > 1.05 * branch.gamma[0]


def test_a_ramp_without_a_stable_locked_cycle_is_refused() -> None:
    """Below the lock there is nothing to begin from."""
    profile, _ = load("simulated")
    low = profile.model_copy(update={"ramp": profile.ramp.model_copy(update={"gamma": (0.5, 1.2)})})
    with pytest.raises(InputError, match="no stable locked cycle"):
        locked_branch(low)
