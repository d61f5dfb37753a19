"""The packages that serving a page needs."""

from __future__ import annotations

import importlib.util

from daq.setup.errors import InputError

MISSING = 'the page needs packages that are not installed ({}); run: pip install "shakerbench[live]"'


def require_packages() -> None:
    """Refuse to go on without them.

    Raises
    ------
    InputError
        With what is missing, and how it is installed.
    """
    missing = [name for name in ("starlette", "uvicorn", "websockets") if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(MISSING.format(", ".join(missing)))
