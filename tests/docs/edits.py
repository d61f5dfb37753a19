"""Edits of a how-to, made in a copy of the files that it names."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
EDIT = re.compile(r"^In `([\w./]+)`, after the line `([^\n]+)`:\n\n```\w*\n(.*?)```", re.MULTILINE | re.DOTALL)


def edited_copy(page: str, package: str, folder: Path) -> list[str]:
    """Copy a package, insert every block of a how-to after the line it names, and return the files changed.

    Raises
    ------
    AssertionError
        Where a line does not stand in its file exactly once.
    """
    shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    edits = EDIT.findall((ROOT / "docs" / "how-to" / page).read_text(encoding="utf-8"))
    for name, anchor, block in edits:
        lines = (folder / name).read_text(encoding="utf-8").splitlines(keepends=True)
        places = [i for i, line in enumerate(lines, start=1) if line.strip() == anchor]
        assert len(places) == 1, f"{name}: {anchor!r} stands there {len(places)} times"
        (folder / name).write_text("".join([*lines[: places[0]], block, *lines[places[0] :]]), encoding="utf-8")
    return [name for name, _, _ in edits]
