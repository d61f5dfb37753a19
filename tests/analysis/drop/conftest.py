"""The synthetic camera for these tests, and where other people's measurements lie."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest


@pytest.fixture(scope="session")
def synthetic() -> ModuleType:
    """The module `synthetic` beside this file."""
    if "drop_synthetic" not in sys.modules:
        spec = importlib.util.spec_from_file_location("drop_synthetic", Path(__file__).with_name("synthetic.py"))
        module = importlib.util.module_from_spec(spec)
        sys.modules["drop_synthetic"] = module
        spec.loader.exec_module(module)
    return sys.modules["drop_synthetic"]


@pytest.fixture(scope="session")
def plain_film(synthetic: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A film of 120 frames at 300 a second, with a rod, blur, flicker and noise, and the block's true rows."""
    target = tmp_path_factory.mktemp("plain") / "drop.avi"
    truth, camera = synthetic.Truth(friction=0.3), synthetic.Camera(fps=300.0)
    return target, synthetic.film(target, truth, camera, 0.4, np.random.default_rng(3))


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of measurements made by others."""
    root = Path(__file__).parents[3]
    folder = Path(os.environ.get("BOUNCE_DATA", root.parent / "shared" / "data"))
    if not (folder / "phyphox").is_dir():
        pytest.skip(f"other people's measurements are not at {folder} (environment variable BOUNCE_DATA)")
    return folder
