"""`bench live` and `bench mcp`: runs started, watched and stopped from a page, or by an agent over standard input."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from bench.outputs import Host, Port
from bench.web.packages import serve_pages
from daq.setup.errors import InputError

INSTRUCTIONS = (
    "A shaken plate with a ball. Plan before you ramp; the simulated rig is free, real hardware must be armed by a "
    "person on the desk's page for each run. A refusal says what was expected and what to do."
)


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


def mcp(runs: Path = typer.Option(Path(), "--runs", metavar="DIR", help="Folder of the recordings.")) -> None:
    """Serve plan, check, ramp, explore, close-loop and the catalogue to an agent (Model Context Protocol, stdio).

    Example: bench mcp --runs runs

    An agent may change the keys of [ramp] and [forcing]; every step meets the profile's limits. Real hardware moves
    only after a person has armed that profile on the page of bench live, for one run.

    Exits 0 when the agent is gone, 2 when the call was wrong.
    """
    from bench.agent.door import Door

    door = Door(runs)
    if importlib.util.find_spec("mcp") is None:
        raise InputError('the agent\'s door needs a package that is not installed; run: pip install "shakerbench[mcp]"')
    from mcp.server.mcpserver import MCPServer
    from mcp.server.mcpserver.exceptions import ToolError

    def spoken(tool: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
        @functools.wraps(tool)
        def answer(*arguments: Any, **named: Any) -> dict[str, Any]:
            try:
                return tool(*arguments, **named)
            except InputError as error:
                raise ToolError(str(error)) from error

        return answer

    server = MCPServer("shakerbench", instructions=INSTRUCTIONS, log_level="ERROR")
    for name in Door.TOOLS:
        server.add_tool(spoken(getattr(door, name)), name)
    server.run()
