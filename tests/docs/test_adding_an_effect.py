"""The how-to for effects: its file becomes an effect in the folder of effects and in a package of one's own."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import model.effects
from model.effects.registry import registry

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "add-an-effect.md").read_text(encoding="utf-8")

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


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """The how-to's file in a folder."""
    code = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert code is not None
    (tmp_path / "updraught.py").write_text(code.group(1), encoding="utf-8")
    return tmp_path


def test_a_file_beside_the_others_is_an_effect(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The how-to is short, and its file is found in the folder of effects with its hook, nothing else edited."""
    assert len(PAGE.splitlines()) < 80
    shipped = len(registry())
    monkeypatch.setattr(model.effects, "__path__", [*model.effects.__path__, str(written)])
    importlib.invalidate_caches()
    found = {r.effect.name: r for r in registry.__wrapped__()}
    monkeypatch.delitem(sys.modules, "model.effects.updraught")
    assert set(found["updraught"].hooks) == {"force"}
    assert len(found) == shipped + 1


def test_the_effect_of_a_laboratory_s_own_package_flies(written: Path) -> None:
    """The how-to's file in an installed package with an entry point lengthens a flight as weaker gravity would."""
    package = written / "lab_effects-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.0\n", encoding="utf-8")
    (package / "entry_points.txt").write_text("[shakerbench.effects]\nupdraught = updraught\n", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(written), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-c", TRIAL],
        cwd=written,
        env=environment,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    ideal, pushed, lighter = map(float, done.stdout.split())
    # take-off is the same in all but the lighter model, whose ball leaves a little earlier
    assert pushed > ideal + 1e-4
    assert abs((pushed - ideal) / (lighter - ideal) - 1.0) < 0.5
