"""The operator's desk: the only room that knows all the others."""

from typing import Any


def __getattr__(name: str) -> Any:
    """``__version__``, looked up only when it is asked for."""
    if name == "__version__":
        from daq.recording.provenance import software_version

        return software_version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
