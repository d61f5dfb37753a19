"""The same benchmark on another tree of this software, printed before one's own: ratios are of one run."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def run_in(tree: Path, script: str, arguments: Sequence[str]) -> None:
    """Run a benchmark's file on the packages of ``tree``; raises CalledProcessError where it fails."""
    print(f"before, {tree}:", flush=True)
    environment = os.environ | {"PYTHONPATH": str(tree.resolve())}
    subprocess.run([sys.executable, "-P", script, *arguments], check=True, env=environment)
    print("now:", flush=True)
