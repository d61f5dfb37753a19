"""The how-to for effects says what is true."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

TRIAL = """
import math
import numpy as np
from model.effects.registry import resolve
from model.integrator.one_step import simulate
from model.tones import Plate
resolve({"updraught": {"push_mps2": 0.5}})
w = 2 * math.pi * 25.0
def lasts(effects):
    plate = Plate(np.array([w]), np.array([2.4j * 9.80665]))
    orbit = simulate(effects, plate, g_mps2=9.80665, period_s=0.04, flights=1)
    return float(orbit.landing_s[0] - orbit.takeoff_s[0])
updraught = lasts({"updraught": {"push_mps2": 0.5, "edge_m": 0.0}})
print(lasts({}), updraught, lasts({"local_gravity": {"excess_mps2": -0.5}}))
"""


@pytest.mark.slow
def test_the_effect_of_the_how_to_flies(tmp_path: Path) -> None:
    """The how-to's file, put beside the others with nothing else edited, lengthens a flight as weaker gravity would."""
    page = (ROOT / "docs" / "how-to" / "add-an-effect.md").read_text(encoding="utf-8")
    assert len(page.splitlines()) < 60
    code = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert code is not None
    skip = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "model", tmp_path / "model", ignore=skip)
    (tmp_path / "model" / "effects" / "updraught.py").write_text(code.group(1), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", TRIAL], cwd=tmp_path, capture_output=True, text=True, timeout=200, check=False
    )
    assert done.returncode == 0, done.stderr
    ideal, pushed, lighter = map(float, done.stdout.split())
    # take-off is the same in all but the lighter world, whose ball leaves a little earlier
    assert pushed > ideal + 1e-4
    assert abs((pushed - ideal) / (lighter - ideal) - 1.0) < 0.5
