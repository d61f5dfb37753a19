"""What tests see of the machine that they run on: nothing that its user left there."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from kernels import folder
from model.effects import user_effects

ROOT = Path(__file__).resolve().parents[1]


def test_home_caches_and_temporary_files_are_the_tests_own() -> None:
    """Kernels, effects and temporary files come from folders that the tests made, and a home of its own is empty."""
    home, temporary = Path.home(), Path(tempfile.gettempdir())
    assert home.name.startswith("bench-tests-") and temporary == home
    assert all(ROOT in place.parents or temporary in place.parents for place in folder.places())
    assert user_effects.folders() == ()
    assert "COLUMNS" not in os.environ


def test_what_the_user_left_is_not_seen(tmp_path: Path) -> None:
    """Under a home with effects, kernels in the temporary folder and a strange environment, the test above passes."""
    (tmp_path / "shakerbench" / "effects").mkdir(parents=True)
    (tmp_path / "shakerbench" / "effects" / "broken.py").write_text("no Python", encoding="utf-8")
    spoilt = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME", "TMPDIR", "NUMBA_CACHE_DIR"), str(tmp_path))
    strange = {
        "COLUMNS": "17",
        "SHAKERBENCH_EFFECTS": "/no/such/folder",
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONHASHSEED": "1",
    }
    test = f"{Path(__file__)}::{test_home_caches_and_temporary_files_are_the_tests_own.__name__}"
    call = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", test]
    done = subprocess.run(
        call, cwd=ROOT, env=os.environ | spoilt | strange, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
