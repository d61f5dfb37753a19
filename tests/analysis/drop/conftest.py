"""The synthetic camera for these tests, and where other people's measurements lie."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

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
def data() -> Path:
    """Folder of measurements made by others."""
    root = Path(__file__).parents[3]
    folder = Path(os.environ.get("BOUNCE_DATA", root.parent / "shared" / "data"))
    if not (folder / "phyphox").is_dir():
        pytest.skip(f"other people's measurements are not at {folder} (environment variable BOUNCE_DATA)")
    return folder
