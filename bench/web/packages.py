"""The packages that serving a page needs, and pages served until Ctrl-C."""

from __future__ import annotations

import importlib.util
import sys
import webbrowser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.terminal.console import print_lines
from daq.setup.errors import InputError


def require_packages() -> None:
    """Refuse to go on without them; raises `InputError` with what is missing, and how it is installed."""
    missing = [name for name in ("starlette", "uvicorn", "websockets") if importlib.util.find_spec(name) is None]
    if missing:
        words = f"the page needs packages that are not installed ({', '.join(missing)})"
        raise InputError(f'{words}; run: pip install "shakerbench[live]"')


def serve_pages(
    modules: Sequence[str],
    folder: Path,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    options: Mapping[str, Any] | None = None,
) -> None:
    """Serve sections until Ctrl-C; their address is printed, and opened in a browser where a person looks on.

    Arguments are as of `bench.web.serve`'s `serve`, `Place` and `bind` (raises `InputError`).
    """
    require_packages()
    from bench.web.serve import Place, bind, serve

    listening, access = bind(host, port)

    def say() -> None:
        print_lines(f"open {access.url} in a browser; Ctrl-C ends the page")
        sys.stdout.flush()
        if sys.stdout.isatty():
            webbrowser.open(access.url)

    serve(listening, access, modules, Place(folder.resolve(), options or {}), on_ready=say)
