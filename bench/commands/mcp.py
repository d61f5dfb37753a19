"""`bench mcp`: the agent's door, spoken over standard input and output."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from daq.setup.errors import InputError

INSTRUCTIONS = (
    "A shaken plate with a ball. Plan before you ramp; the simulated rig is free, real hardware must be armed by a "
    "person on the desk's page for each run. A refusal says what was expected and what to do."
)


def command(runs: Path = typer.Option(Path(), "--runs", metavar="DIR", help="Folder of the recordings.")) -> None:
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
