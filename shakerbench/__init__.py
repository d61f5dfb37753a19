"""A completely inelastic ball on a shaken plate: drive it, record it, predict it, explain it.

Public names are imported on first use, so that ``import shakerbench`` is instant.

Examples
--------
>>> import shakerbench as sb
>>> ball = sb.make_ball(c=2)
>>> sb.attractor(ball, 1.28).label
'3-cycle with reset, period 2'
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from shakerbench._shadow import refuse_shadowed

if TYPE_CHECKING:
    from shakerbench.measuring import close_loop, compare, drop, find_flights, open_recording, plate_motion
    from shakerbench.predicting import attractor, bifurcations, diagram, make_ball, predict
    from shakerbench.running import load_profile, run

    __version__: str

refuse_shadowed()

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
