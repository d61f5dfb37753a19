"""A completely inelastic ball on a shaken plate: drive it, record it, predict it, explain it.

Public names are imported on first use, so that ``import shakerbench`` is instant. The packages next to this one
must be ours, and not others of the same name: decision 129.

Examples
--------
>>> import shakerbench as sb
>>> ball = sb.make_ball(c=2)
>>> sb.attractor(ball, 1.28).label
'3-cycle with reset, period 2'
"""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shakerbench.measuring import close_loop, compare, drop, find_flights, open_recording, plate_motion
    from shakerbench.predicting import attractor, bifurcations, diagram, make_ball, predict
    from shakerbench.running import load_profile, run

    __version__: str

_PACKAGES = ("kernels", "daq", "model", "rig", "analysis", "bench")


def _refuse_shadowed() -> None:
    """Refuse to run (ImportError) where another package, or a script, bears the name of one of ours and comes first."""
    home = Path(__file__).resolve().parents[1]
    for name in _PACKAGES:
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


_refuse_shadowed()

_HOME = {
    "measuring": ("open_recording", "find_flights", "plate_motion", "compare", "close_loop", "drop"),
    "predicting": ("make_ball", "attractor", "diagram", "bifurcations", "predict"),
    "running": ("load_profile", "run"),
}

__all__ = [
    "__version__", "attractor", "bifurcations", "close_loop", "compare", "diagram", "drop", "find_flights",
    "load_profile", "make_ball", "open_recording", "plate_motion", "predict", "run",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """The public name, from the module that defines it."""
    if name == "__version__":
        from daq.setup.provenance import software_version

        return software_version()
    import importlib

    for module, names in _HOME.items():
        if name in names:
            return getattr(importlib.import_module(f"shakerbench.{module}"), name)
    raise AttributeError(f"module 'shakerbench' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    """The public names."""
    return __all__
