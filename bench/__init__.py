"""The command line `bench`: with `shakerbench` the only package that imports all the others.

Other packages take `jobs`, `predict`, `profiles`, `terminal`.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    """``__version__``, looked up only when it is asked for."""
    if name == "__version__":
        from daq.setup.provenance import software_version

        return software_version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
