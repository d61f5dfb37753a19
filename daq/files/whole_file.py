"""Files that appear whole or not at all.

What is written gets a name beside the final one, reaches the disk, and is renamed in one step. A
process that is killed half-way leaves the old file as it was, and at most a ``.part`` beside it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Name of a file to write, which takes the place of ``path`` when the block ends well and is removed otherwise.

    The mode of a file that is replaced stays; a symbolic link stays one, and what it leads to is replaced. A device or
    a pipe is written to directly.

    Raises
    ------
    OSError
        When the disk refuses; ``path`` is then as it was.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = path.resolve() if path.is_symlink() else path
    part = target.with_name(f"{target.name}.part")
    try:
        yield part
        if target.exists():
            shutil.copymode(target, part)
        sync(part)
        part.replace(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_whole(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8 into ``path``, whole or not at all (raises OSError)."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def sync(path: Path) -> None:
    """Ask the operating system to put the file on the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
