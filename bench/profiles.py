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
    path = find_profile(name_or_path)
    profile, text = load_profile(path)
    _check_declared(profile, path)
    return profile, text


def load_measuring(name_or_path: str | Path) -> tuple[Setup, str]:
    """The measuring part of a profile and its text, by path or shipped name (raises `InputError`)."""
    path = find_profile(name_or_path)
    setup, text = load_setup(path)
    _check_declared(setup, path)
    return setup, text


def _check_declared(setup: Setup, path: Path) -> None:
    """Refuse declared effects that the model does not know; only this room knows both profile and model."""
    if not setup.declared:
        return
    from model.effects import resolve

    faults = []
    for name, values in setup.declared_values().items():
        try:
            resolve({name: values})
        except ValueError as error:
            faults.append(f"  declared.{name}: {error}")
    if faults:
        raise InputError("\n".join([f"{path}: declared effects that do not fit", *faults]))
