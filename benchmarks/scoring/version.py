"""The version of the code that a score belongs to: a hash of everything that decides a verdict.

Commits that change documentation alone keep it, so scores are not thrown away for a comma.
"""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("kernels", "model", "daq", "analysis")
PLANTS = ("rig/sim", "benchmarks/plants", "benchmarks/scoring/trial.py")


@functools.cache
def code_version(*beside: str) -> str:
    """Twelve hexadecimal digits of the hash of the sources that judge, of those that make the recordings, and more."""
    found = hashlib.sha256()
    for place in (*ROOMS, *PLANTS, *beside):
        path = ROOT / place
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            found.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return found.hexdigest()[:12]
