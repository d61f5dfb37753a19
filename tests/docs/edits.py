"""Edits of a how-to, made in a copy of the files that it names."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
EDIT = re.compile(
    r"^In `([\w./]+)`, (after|in place of) the line `([^\n]+)`:\n\n```\w*\n(.*?)```", re.MULTILINE | re.DOTALL
)
NEW = re.compile(r"^Write a module as `([\w./]+)`:\n\n```\w*\n(.*?)```", re.MULTILINE | re.DOTALL)


def edited_copy(page: str, folder: Path) -> list[str]:
    """Copy the packages that a how-to edits, put its blocks where it says, and return the files changed.

    Raises
    ------
    AssertionError
        Where a line does not stand in its file exactly once.
    """
    text = (ROOT / "docs" / "how-to" / page).read_text(encoding="utf-8")
    edits, new = EDIT.findall(text), NEW.findall(text)
    for package in {name.split("/")[0] for name, *_ in (*edits, *new)}:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name, where, anchor, block in edits:
        lines = (folder / name).read_text(encoding="utf-8").splitlines(keepends=True)
        places = [i for i, line in enumerate(lines) if line.strip() == anchor]
        assert len(places) == 1, f"{name}: {anchor!r} stands there {len(places)} times"
        before = places[0] + (where == "after")
        (folder / name).write_text("".join([*lines[:before], block, *lines[places[0] + 1 :]]), encoding="utf-8")
    for name, block in new:
        (folder / name).write_text(block, encoding="utf-8")
    return [name for name, *_ in (*new, *edits)]


def run_in(folder: Path, code: str) -> list[list[float]]:
    """Run a program that finds the packages of a folder first; the numbers of each line that it prints.

    Raises
    ------
    AssertionError
        Where the program fails, with what it wrote.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200, check=False
    )
    assert done.returncode == 0, done.stderr
    return [[float(word) for word in line.split()] for line in done.stdout.splitlines()]
