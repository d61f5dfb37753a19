"""Files that a kill cannot tear: written whole or not at all, or grown line by line.

A file that is written gets another name in the same folder, reaches the disk, and is renamed in one step: a process
that is killed half-way leaves the old file as it was, and at most a ``.part``. A journal has one JSON object a line,
on the disk before the next one is begun; a last line that was cut off is left out.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from daq.setup.errors import InputError


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Name of a file to write, which takes the place of ``path`` when the block ends well and is removed otherwise.

    The mode of a file that is replaced stays; a symbolic link stays one, and what it leads to is replaced. A device or
    a pipe is written to directly.

    Raises `OSError` when the disk refuses; ``path`` is then as it was.
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
        sync_folder(target.parent)
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


def sync_folder(folder: Path) -> None:
    """Ask the operating system to put the names in a folder on the disk: a file's own sync does not promise its name.

    POSIX only: Windows syncs no folder, and its file systems log changes of names.
    """
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system that knows no sync of folders, as some of networks
            raise
    finally:
        os.close(descriptor)


Row = dict[str, Any]


class Journal:
    """Rows by key in a file that only grows; of rows with one key the last counts.

    ``path`` is its file, made by the first row; ``rows`` are those so far, by key. Raises `InputError` where the file
    holds something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, Row] = {}
        self._is_new = not path.exists()
        text = b"" if self._is_new else path.read_bytes()
        lines = text.split(b"\n")
        for number, line in enumerate(lines[:-1], start=1):
            if not line.strip():
                continue
            try:
                entry = json.loads(line)
                self.rows[str(entry["key"])] = dict(entry["row"])
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(
                    f"{path}, line {number}: wanted a result written by this program ({error}); name another file, or "
                    "remove the line"
                ) from error
        self._torn = bool(lines[-1])
        self._whole_bytes = len(text) - len(lines[-1])

    def add(self, key: str, row: Row) -> None:
        """Add a row; it is on the disk when this returns (raises OSError)."""
        line = json.dumps({"key": key, "row": row}, allow_nan=False)
        if self._torn:
            os.truncate(self.path, self._whole_bytes)
            self._torn = False
        with self.path.open("ab") as stream:
            stream.write(line.encode() + b"\n")
            stream.flush()
            os.fsync(stream.fileno())
        if self._is_new:
            sync_folder(self.path.parent)
            self._is_new = False
        self.rows[key] = row
