"""Find a rig profile or a scenario by its path or shipped name; the programme of a profile's ramp and its limits.

A path wins over a name; a name that is not found is answered with those that are.
"""

from __future__ import annotations

import difflib
from pathlib import Path

from daq.setup.errors import InputError
from daq.setup.setup import Setup
from rig.profile import Profile, load_profile, load_setup
from rig.programme.ramp import Peaks, Programme, Step, forbidden, peaks, plan

_BENCH = Path(__file__).resolve().parents[1]


def shipped_folder(kind: str = "rig_profiles") -> Path:
    """Folder of the shipped profiles (or ``scenarios``): inside an installed `bench`, next to it in a checkout."""
    installed = _BENCH / kind
    return installed if installed.is_dir() else _BENCH.parent / kind


def shipped_names() -> list[str]:
    """Names of the shipped profiles."""
    return sorted(path.stem for path in shipped_folder().glob("*.toml"))


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return sorted(path.stem for path in shipped_folder("scenarios").glob("*.toml"))


def find_profile(name_or_path: str | Path) -> Path:
    """The profile's file; raises `InputError` where there is neither such a file nor such a shipped profile."""
    return _find(Path(name_or_path), "rig_profiles", "profile", shipped_names())


def find_scenario(name_or_path: str | Path) -> Path:
    """The scenario's file; raises `InputError` where there is neither such a file nor such a shipped scenario."""
    return _find(Path(name_or_path), "scenarios", "scenario", scenario_names())


def _find(path: Path, kind: str, what: str, names: list[str]) -> Path:
    """``path`` itself, or what is shipped under its name."""
    if path.is_file():
        return path
    shipped = shipped_folder(kind) / f"{path.name.removesuffix('.toml')}.toml"
    if path.parent.name in ("", kind) and shipped.is_file():
        return shipped
    near = difflib.get_close_matches(path.stem, names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"shipped {what}s: {', '.join(names)}"
    raise InputError(f"{path}: no such {what} file, and no shipped {what} of that name; {hint}")


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
    """Refuse declared effects that the model does not know; neither `rig` nor `daq` imports the model."""
    faults = []
    for name, values in setup.declared_values().items():
        from model.effects.registry import resolve  # slow, and most profiles declare nothing

        try:
            resolve({name: values})
        except ValueError as error:
            faults.append(f"  declared.{name}: {error}")
    if faults:
        raise InputError("\n".join([f"{path}: declared effects that do not fit", *faults]))


def planned(profile: Profile) -> tuple[Programme, list[tuple[Step, Peaks]], list[str]]:
    """The programme, each step with its peaks, and one line for each limit that a step would exceed."""
    programme = plan(profile)
    by_gamma = {gamma: peaks(profile, gamma) for gamma in {step.gamma for step in programme.steps}}
    rows = [(step, by_gamma[step.gamma]) for step in programme.steps]
    faults = [line for step, asked in rows for line in forbidden(profile.limits, step, asked)]
    return programme, rows, faults


def refusal(profile: str, faults: list[str]) -> str:
    """The message that refuses a ramp."""
    shown = "\n".join(f"  {line}" for line in faults[:20])
    more = f"\n  and {len(faults) - 20} more" if len(faults) > 20 else ""
    return f"{profile}: limits forbid this ramp; lower ramp.gamma or change [limits]\n{shown}{more}"


def refuse_forbidden(name: str, profile: Profile) -> None:
    """Refuse a ramp that a limit forbids, with step and limit (`InputError`); ``name`` is how it was called."""
    if faults := planned(profile)[2]:
        raise InputError(refusal(name, faults))
