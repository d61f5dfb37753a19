"""`bench live`: a page on which runs are started, watched and stopped."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from bench.outputs import Host, Port
from bench.terminal.console import print_lines
from bench.web.packages import serve_pages
from daq.setup.errors import InputError


def command(
    profile: str | None = typer.Argument(None, help="A profile's path or name, offered first."),
    runs: Path = typer.Option(Path(), "--runs", metavar="DIR", help="Folder of the recordings."),
    host: Host = "127.0.0.1",
    port: Port = None,
) -> None:
    """Serve the page until Ctrl-C; runs are processes of their own and go on without it.

    Example: bench live simulated --runs runs

    Exits 0 when stopped, 2 when the call was wrong.
    """
    from bench.live.processes import sections

    def say(url: str) -> None:
        print_lines(f"open {url} in a browser; Ctrl-C ends the page")
        sys.stdout.flush()

    if not runs.is_dir():
        raise InputError(f"--runs {runs}: no such folder; create it first, or name another")
    modules = sections()
    from bench.live.pages import offered_profiles  # needs the packages that `sections` asks for

    offered = offered_profiles(runs, profile)
    serve_pages(modules, runs, say, host=host, port=port, options={"live": {"offered": offered}})
