"""Effects of the user, besides the installed library: files in folders of the user's own.

The folders are named by the environment variable ``SHAKERBENCH_EFFECTS`` (several as in ``PATH``; empty: none), else it
is one folder among the user's own data. They are never looked for near recordings or in the working directory: such a
file is a program, and whoever sends a recording must not bring one. Decision 139.
"""

from __future__ import annotations

import inspect
import keyword
import os
import sys
import traceback
from pathlib import Path
from types import ModuleType

from kernels.errors import InputError

VARIABLE = "SHAKERBENCH_EFFECTS"
PACKAGE = "model.effects"


class EffectFileError(InputError):
    """A file of the library of effects that cannot be one."""


def user_folder() -> Path:
    """The user's folder of effects where the environment names none."""
    home = Path.home()
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Application Support"
    else:
        base = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    return base / "shakerbench" / "effects"


def folders() -> tuple[Path, ...]:
    """Folders of the user's effects, the one that is written to first.

    Raises `EffectFileError` where the environment names a folder that is not there.
    """
    given = os.environ.get(VARIABLE)
    if given is None:
        try:
            return (user_folder(),)
        except RuntimeError:  # no home
            return ()
    out = tuple(Path(part) for part in given.split(os.pathsep) if part)
    for folder in out:
        if folder.exists() and not folder.is_dir():
            raise EffectFileError(f"{VARIABLE}: {folder} is a file; wanted a folder of effects")
    return out


_left_out: set[Path] = set()


def leave_out(path: Path) -> None:
    """Do not read the file ``path`` in this process: it is to be written anew."""
    _left_out.add(path.resolve())


def effect_files() -> tuple[Path, ...]:
    """Files of the user's effects, in the order of their folders and names; none is read."""
    found = (path for folder in folders() if folder.is_dir() for path in sorted(folder.glob("*.py")))
    return tuple(path for path in found if not path.stem.startswith("_") and path.resolve() not in _left_out)


def check_name(name: str) -> None:
    """Refuse what cannot be the name of an effect; raises `InputError` with what was wanted."""
    if not (name.isidentifier() and name.isascii() and name == name.lower() and not name.startswith("_")):
        raise InputError(f"{name!r} cannot be an effect's name; wanted small letters, digits and _, as sticky_rod")
    if keyword.iskeyword(name) or keyword.issoftkeyword(name):
        raise InputError(f"{name!r} is a word of Python and cannot be an effect's name; wanted one as sticky_rod")


def load(path: Path) -> ModuleType:
    """The module of a user's effect, read from its source: no compiled copy can be older than the file.

    Raises `EffectFileError` where it cannot be read or run, with the line.
    """
    try:
        check_name(path.stem)
        code = compile(path.read_bytes(), str(path), "exec")
    except SyntaxError as error:
        raise EffectFileError(
            f"{path}, line {error.lineno}: {error.msg}; wanted a file like those of bench close-loop --keep-term"
        ) from error
    except (OSError, ValueError) as error:
        raise EffectFileError(f"{path}: {error}") from error
    module = ModuleType(f"{PACKAGE}.{path.stem}")
    module.__file__, module.__package__ = str(path), PACKAGE
    sys.modules[module.__name__] = module
    try:
        exec(code, module.__dict__)
    except Exception as error:
        del sys.modules[module.__name__]
        # the last line of the file that the error came through
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f", line {lines[-1]}" if lines else ""
        raise EffectFileError(f"{path}{where}: {type(error).__name__}: {error}") from error
    return module


def check_signature(path: str, hook: str, function: object, wanted: str) -> None:
    """Refuse a hook of other arguments than its kind has.

    Raises `EffectFileError` with the line and what was wanted.
    """
    plain = inspect.unwrap(getattr(function, "py_func", function))  # type: ignore[arg-type]
    found = list(inspect.signature(plain).parameters)
    if len(found) != len(wanted.split(",")):
        line = plain.__code__.co_firstlineno
        raise EffectFileError(f"{path}, line {line}: {hook}({', '.join(found)}); wanted {hook}({wanted})")
