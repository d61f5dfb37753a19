"""The folder of compiled kernels, one for each set of versions, and the hash by which a kernel is found in it.

It lies in the user's own cache. Where that cannot be written (no home, a read-only system) a temporary folder serves,
and one line says so.

The hash is that of bytecode, constants and options, and of every kernel that is called: numba compiles the values of
global names into the machine code. Files and line numbers do not count: a comment, a docstring or a moved function
changes nothing.
"""

from __future__ import annotations

import contextlib
import enum
import functools
import hashlib
import importlib.metadata
import logging
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from kernels.lanes import Intrinsic

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
    for place in places()[len(_given_up) :]:
        try:
            _make(place)
            # whole under its final name or not at all: other processes read while this one writes
            handle, part = tempfile.mkstemp(dir=place, suffix=".part")
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            Path(part).replace(place / f"{name}.bin")
        except OSError as error:
            _given_up.append(place)
            if multiprocessing.parent_process() is None:  # once, not in every worker
                left = places()[len(_given_up) :]
                where = f"they are stored in {left[0]} instead" if left else "every run compiles them anew"
                _log.warning("compiled kernels cannot be stored in %s (%s): %s; %s names another folder", place,
                             error.strerror or error, where, GIVEN)  # fmt: skip
            continue
        return


_given_up: list[Path] = []
"""Places that cannot be written."""


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


Parts = list[object]
_TEXT = re.compile(r'^[ \t]*("""[\s\S]*?"""|#[^\n]*)?[ \t]*\n|[ \t]+#[^\n]*$', re.MULTILINE)


@functools.cache
def fingerprint(dispatcher: Any) -> str:
    """The hash of a compiled function and of all that it reaches, as hexadecimal digits."""
    parts: Parts = []
    _kernel(dispatcher, parts, {})
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def fingerprint_of_closure(function: FunctionType) -> str:
    """The hash of a function and of what a factory has given it: two of one name differ."""
    parts: Parts = []
    _function(function, parts, {})
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def fingerprint_of_sources(sources: Iterable[str]) -> str:
    """The hash of modules by their code: docstrings, comments and blank lines do not count."""
    # by a pattern: parsing this package takes longer than most kernels run, in each process
    return hashlib.sha256("".join(map(without_text, sources)).encode()).hexdigest()


def without_text(source: str) -> str:
    """A module's source without docstrings, comments and blank lines."""
    return _TEXT.sub("", source)


def _kernel(dispatcher: Any, parts: Parts, seen: dict[int, int]) -> None:
    """Add a compiled function; one met before is named by its number."""
    # kernels that call each other would never end
    if id(dispatcher) in seen:
        parts.append(("met", seen[id(dispatcher)]))
        return
    seen[id(dispatcher)] = len(seen)
    function = dispatcher.py_func
    parts.append(("options", sorted((key, _plain(value)) for key, value in dispatcher.targetoptions.items())))
    _function(function, parts, seen)


def _function(function: FunctionType, parts: Parts, seen: dict[int, int]) -> None:
    parts.append(("function", function.__module__, function.__qualname__))
    _value(function.__defaults__, parts, seen)
    for cell in function.__closure__ or ():
        _value(cell.cell_contents, parts, seen)
    _code(function.__code__, function.__globals__, parts, seen, function.__doc__)


def _code(code: CodeType, names: dict[str, Any], parts: Parts, seen: dict[int, int], text: str | None = None) -> None:
    """Add bytecode, its constants but for the docstring ``text``, and the values of the global names it reads."""
    parts.append(("code", code.co_code, code.co_names, code.co_varnames, code.co_argcount))
    for i, constant in enumerate(code.co_consts):
        if isinstance(constant, CodeType):
            _code(constant, names, parts, seen)
        elif i == 0 and constant == text:  # the docstring comes first; without one its place holds None
            continue
        else:
            _value(constant, parts, seen)
    for value in (names[name] for name in code.co_names if name in names):
        if not isinstance(value, ModuleType):
            _value(value, parts, seen)
            continue
        # of a module only what the code may use of it: attributes stand among the names as well
        parts.append(("module", value.__name__))
        for name in code.co_names:
            if hasattr(value, name):
                _value(getattr(value, name), parts, seen)


def _value(value: Any, parts: Parts, seen: dict[int, int]) -> None:
    """Add a value that numba may compile in."""
    if hasattr(value, "py_func"):  # a kernel, or a function compiled by numba itself
        _kernel(value, parts, seen)
    elif isinstance(value, Intrinsic):
        parts.append(("intrinsic", value.name))
    elif isinstance(value, enum.Enum):
        parts.append((type(value).__qualname__, value.name, value.value))
    elif isinstance(value, type) and issubclass(value, enum.Enum):
        parts.append((value.__qualname__, [(member.name, member.value) for member in value]))
    elif isinstance(value, np.ndarray):
        parts.append(("array", value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()))
    elif isinstance(value, tuple):
        parts.append(("tuple", type(value).__qualname__, len(value)))
        for item in value:
            _value(item, parts, seen)
    else:
        parts.append(_plain(value))


def _plain(value: Any) -> object:
    """A value as it is in every process: no address, no order of a set."""
    if value is None or isinstance(value, int | float | complex | str | bytes | np.generic):
        return type(value).__name__, repr(value)
    if isinstance(value, set | frozenset):
        return "set", sorted(map(repr, value))
    named = getattr(value, "__module__", ""), getattr(value, "__qualname__", getattr(value, "__name__", ""))
    return type(value).__qualname__, *named, *getattr(value, "_fields", ())
