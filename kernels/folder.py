"""The folder of compiled kernels: one for each set of versions, in the user's own cache.

Where that cannot be written (no home, a read-only system) a temporary folder serves, and one line says so.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import logging
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

NAME = "shakerbench"
GIVEN = "NUMBA_CACHE_DIR"
"""The variable of the environment that names another folder."""
UNUSED_DAYS = 30.0
"""After which kernels of other versions, or of a source since edited, are removed."""
DAY_S = 86400.0

_log = logging.getLogger(NAME)


@functools.cache
def places() -> tuple[Path, ...]:
    """Folders for this set of versions, best first: the environment's or the user's, then a temporary one."""
    given = os.environ.get(GIVEN)
    first = Path(given) if given else _user_cache()
    return tuple(base / "kernels" / _versions() for base in (first, _temporary()) if base is not None)


def read(name: str) -> bytes | None:
    """What was stored under ``name``; None when nothing was."""
    for place in places():
        path = place / f"{name}.bin"
        try:
            data = path.read_bytes()
            if time.time() - path.stat().st_mtime > DAY_S:
                with contextlib.suppress(OSError):  # a cache that may only be read
                    os.utime(path)  # in use: not to be removed
        except OSError:
            continue
        return data
    return None


def write(name: str, data: bytes) -> None:
    """Store ``data`` under ``name`` where the first place allows it; says once where the second had to do."""
    for place in places()[_unfit() :]:
        try:
            _make(place)
            # whole under its final name or not at all: other processes read while this one writes
            handle, part = tempfile.mkstemp(dir=place, suffix=".part")
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            Path(part).replace(place / f"{name}.bin")
        except OSError as error:
            _give_up(place, error)
            continue
        return


_given_up: list[Path] = []


def _unfit() -> int:
    """How many of the places cannot be written."""
    return len(_given_up)


def _give_up(place: Path, error: OSError) -> None:
    """Turn to the next place, and say so once: not in every worker."""
    _given_up.append(place)
    if multiprocessing.parent_process() is not None:
        return
    left = places()[_unfit() :]
    where = f"they are stored in {left[0]} instead" if left else "every run compiles them anew"
    _log.warning("compiled kernels cannot be stored in %s (%s): %s; %s names another folder", place,
                 error.strerror or error, where, GIVEN)  # fmt: skip


@functools.cache
def _make(place: Path) -> None:
    """Make the folder, readable by no other user, and remove what has not been used for long."""
    place.mkdir(parents=True, exist_ok=True, mode=0o700)
    for path in (*place.parent.iterdir(), *place.iterdir()):
        with contextlib.suppress(OSError):  # another process removes it, too
            # a kernel's last use, or that of any in a folder of other versions
            used_s = max((p.stat().st_mtime for p in (path, *path.glob("*.bin"))), default=0.0)
            if path == place or time.time() - used_s < UNUSED_DAYS * DAY_S:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()


def _user_cache() -> Path | None:
    """The folder in which the user's programs keep what can be made again; None without a home."""
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA")
        return Path(local) / NAME if local else None
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / NAME
    given = os.environ.get("XDG_CACHE_HOME")
    return (Path(given) if given else home / ".cache") / NAME


def _temporary() -> Path | None:
    """A temporary folder of this user's own, the same for every process; None where another user made it.

    Machine code is read from it: no other user may be able to write there.
    """
    try:
        base = Path(tempfile.gettempdir())
    except OSError:  # none can be written
        return None
    if not hasattr(os, "getuid"):  # Windows: the temporary folder is the user's own
        return base / NAME
    own = base / f"{NAME}-{os.getuid()}"
    try:
        own.mkdir(mode=0o700, exist_ok=True)
        status = own.lstat()
    except OSError:
        return None
    return own if status.st_uid == os.getuid() and not status.st_mode & 0o022 and not own.is_symlink() else None


@functools.cache
def _versions() -> str:
    """Everything but the sources that decides what a kernel compiles to, as a folder's name."""
    version = importlib.metadata.version  # numba itself need not be imported
    try:
        package = version(NAME)
    except importlib.metadata.PackageNotFoundError:
        package = "source"
    python = f"{sys.implementation.cache_tag}-{sys.platform}"
    return f"{package}-{python}-numba-{version('numba')}-llvmlite-{version('llvmlite')}"
