"""Find a rig profile by its path, or by the name under which it is shipped.

The rule kept here: a path wins over a name, and what is not found is answered with what there is.
"""

from __future__ import annotations

import difflib
from pathlib import Path

from daq.errors import InputError
from daq.setup import Setup
from rig.profile import Profile, load_profile, load_setup

_HERE = Path(__file__).resolve().parent


def shipped_folder() -> Path:
    """Where the shipped profiles lie: inside an installed `bench`, beside it in a checkout."""
    installed = _HERE / "rig_profiles"
    return installed if installed.is_dir() else _HERE.parent / "rig_profiles"


def shipped_names() -> list[str]:
    """Names of the shipped profiles."""
    return sorted(path.stem for path in shipped_folder().glob("*.toml"))


def find_profile(name_or_path: str | Path) -> Path:
    """The profile's file.

    Raises
    ------
    daq.errors.InputError
        When there is neither such a file nor such a shipped profile.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    names = shipped_names()
    shipped = shipped_folder() / f"{path.name.removesuffix('.toml')}.toml"
    if path.parent.name in ("", "rig_profiles") and shipped.is_file():
        return shipped
    near = difflib.get_close_matches(path.stem, names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"shipped profiles: {', '.join(names)}"
    raise InputError(f"{name_or_path}: no such profile file, and no shipped profile of that name; {hint}")


def load(name_or_path: str | Path) -> tuple[Profile, str]:
    """A whole profile and its text, by path or shipped name (raises `InputError`)."""
    return load_profile(find_profile(name_or_path))


def load_measuring(name_or_path: str | Path) -> tuple[Setup, str]:
    """The measuring part of a profile and its text, by path or shipped name (raises `InputError`)."""
    return load_setup(find_profile(name_or_path))
