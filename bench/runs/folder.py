"""Files below the runs' folder that the catalogue knows: recordings, tags and notes, verdicts."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bench.jobs.loops.keep_verdict import SAVED
from daq.recording.notebook import ENDING
from daq.setup.errors import InputError

PLACE = ".shakerbench"
"""Folder, in the runs' folder, of what can be made again: the catalogue, the pyramids, the flights."""
RECORDINGS = (".h5", ".hdf5")

Kind = Literal["hdf5", "remarks", "loop"]


@dataclass(frozen=True)
class Found:
    """A file: its path below the folder with forward slashes, its size and time of change."""

    path: str
    size: int
    mtime_ns: int

    @property
    def kind(self) -> Kind:
        """The kind of file that its name stands for."""
        if self.path.endswith(ENDING):
            return "remarks"
        return "loop" if self.path.lower().endswith(SAVED) else "hdf5"


def run_id(path: str) -> str:
    """Short name of a recording in addresses: a hash of its path below the folder."""
    return hashlib.sha256(path.encode("utf-8", "surrogateescape")).hexdigest()[:12]


def files_below(folder: Path) -> Iterator[Found]:
    """Files below a folder that may matter to the catalogue, without hidden ones and links that lead out of it.

    Raises `InputError` where the folder is none, or cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: wanted the folder of the recordings; there is none of that name")
    root = folder.resolve()
    try:
        yield from _below(root, "", root, 0)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from error


def _below(folder: Path, prefix: str, root: Path, depth: int) -> Iterator[Found]:
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda one: one.name):
            name = entry.name
            if name.startswith(".") or any("\ud800" <= c <= "\udfff" for c in name):  # a name in another code page
                continue
            try:
                if entry.is_dir(follow_symlinks=False):
                    if depth < 32:
                        yield from _below(Path(entry.path), f"{prefix}{name}/", root, depth + 1)
                    continue
                if not name.lower().endswith((*RECORDINGS, SAVED, ENDING)):
                    continue
                if entry.is_symlink() and not Path(entry.path).resolve(strict=True).is_relative_to(root):
                    continue
                state = entry.stat()
            except (OSError, RuntimeError):
                continue  # gone since, or a folder that may not be read
            yield Found(prefix + name, state.st_size, state.st_mtime_ns)
