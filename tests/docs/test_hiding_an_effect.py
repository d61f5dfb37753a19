"""The how-to for the simulated rig: its edits, made in a copy of the rig, hide an effect that moves the ball."""

import os
import subprocess
import sys
from pathlib import Path

from tests.docs.edits import ROOT, edited_copy

TRIAL = """
import math
import numpy as np
from rig.sim.forces import net
from rig.sim.scenario import Scenario
from rig.sim.state import initial_state
state = initial_state(1, 2, 0.0)[0]
for effects in ({}, {"updraught": {"push_mps2": 0.8, "edge_m": 0.002}}):
    params, _ = Scenario("one", effects).parameters()
    p = params[0]
    print(int(p["is_ballistic"]), int(p["is_simple"]), *(net(state, p, h, 0.0, 0.0, 0.0, 0.0) for h in (1e-3, 3e-3)))
"""


def test_the_how_to_for_hiding_an_effect_makes_one(tmp_path: Path) -> None:
    """With the how-to's edits the ball is pushed up above the edge, by what the scenario says, in every interval."""
    changed = edited_copy("hide-an-effect.md", "rig", tmp_path)
    assert len(changed) == 3
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-c", TRIAL],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    without, hidden = (list(map(float, line.split())) for line in done.stdout.splitlines())
    assert without[:2] == [1.0, 1.0]
    assert hidden[:2] == [0.0, 0.0]
    assert abs(hidden[2] - without[2]) < 1e-12
    assert abs(hidden[3] - without[3] - 0.8) < 1e-12
