"""Version and commit of the software that makes a file; an unknown commit is an empty text, never guessed."""

from __future__ import annotations

import functools
import importlib.metadata
import shutil
import subprocess
from pathlib import Path

DISTRIBUTION = "shakerbench"


def software_version() -> str:
    """Installed version, or ``unknown`` when run from a bare checkout."""
    try:
        return importlib.metadata.version(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


@functools.cache
def software_commit() -> str:
    """Commit of the checkout this code runs from (``+changes`` when it differs), or an empty text."""
    here = Path(__file__).resolve().parents[2]
    git = shutil.which("git")
    if git is None or not (here / ".git").exists():
        return ""
    commit = _git(git, here, "rev-parse", "HEAD")
    if not commit:
        return ""
    return commit + ("+changes" if _git(git, here, "status", "--porcelain", "--untracked-files=no") else "")


def _git(git: str, where: Path, *arguments: str) -> str:
    """Standard output of a git command, empty when it fails."""
    try:
        done = subprocess.run([git, "-C", str(where), *arguments], capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
