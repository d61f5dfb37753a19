"""`bench live`: a page on which runs are started, watched and stopped."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import Host, Port
from bench.web.packages import serve_pages
from daq.setup.errors import InputError


def command(
    profile: str | None = typer.Argument(
        None, help="A profile's path or name, for a folder in which none was chosen yet."
    ),
    runs: Path = typer.Option(Path(), "--runs", metavar="DIR", help="Folder of the recordings."),
    host: Host = "127.0.0.1",
    port: Port = None,
) -> None:
    """Serve the page until Ctrl-C; runs are processes of their own and go on without it.

    Example: bench live simulated --runs runs

    Exits 0 when stopped, 2 when the call was wrong.
    """
    if not runs.is_dir():
        raise InputError(f"--runs {runs}: no such folder; create it first, or name another")
    open_page(runs, profile, host, port)


def open_page(runs: Path, profile: str | None, host: str = "127.0.0.1", port: int | None = None) -> None:
    """Serve the desk until Ctrl-C; as `command`, in a folder that is there."""
    from bench.live.processes import SECTIONS
    from bench.profiles.find import find_profile

    if profile is not None:
        find_profile(profile)
    modules = ("bench.gates.desk", *SECTIONS)  # the six gates, where runs are started from the page
    serve_pages(modules, runs, host=host, port=port, options={"gates": {"offered": profile}})
