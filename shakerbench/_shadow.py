"""The check that the packages next to this one are ours, and not others of the same name. Decision 129."""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from pathlib import Path

PACKAGES = ("kernels", "daq", "model", "rig", "analysis", "bench")


def refuse_shadowed() -> None:
    """Refuse to run where another package, or a script, bears the name of one of ours and comes first.

    Raises
    ------
    ImportError
        With the name, the place that was found and the place that was wanted.
    """
    home = Path(__file__).resolve().parents[1]
    for name in PACKAGES:
        wanted = home / name / "__init__.py"
        found = _found(name)
        if found is None or found.resolve() != wanted:
            raise ImportError(
                f"shakerbench needs its own package {name!r} at {wanted.parent}, but 'import {name}' gives "
                f"{found or 'none'}: rename that file or folder, leave its folder, or install shakerbench in a virtual "
                "environment of its own",
                name=name,
            )


def _found(name: str) -> Path | None:
    """The file that ``import name`` gives; a folder without ``__init__.py`` is named as such."""
    module = sys.modules.get(name)
    spec = getattr(module, "__spec__", None) if module is not None else PathFinder.find_spec(name)
    if spec is None:
        file = getattr(module, "__file__", None)
        return None if file is None else Path(file)
    if spec.origin is None:
        return next((Path(place) for place in spec.submodule_search_locations or ()), None)
    return Path(spec.origin)
