"""Lets the tests of `model` import the reference solvers beside them."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
